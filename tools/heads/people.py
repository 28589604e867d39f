"""Who is made: targets of the base mesh, parts and colours. Units of colours: sRGB, 0 to 255."""

_SOFT = {"eyes/@-eye-height2-incr": 0.35, "eyes/@-eye-height1-incr": 0.2}

PEOPLE = {
    "Ada": {
        "mix": [("caucasian", "female", "young", 0.85), ("asian", "female", "young", 0.15)],
        "details": {**_SOFT, "eyebrows/eyebrows-angle-up": 0.7, "eyebrows/eyebrows-trans-up": 0.35,
                    "mouth/mouth-angles-up": 0.25},
        "skin": "young_caucasian_female/textures/young_lightskinned_female_diffuse2.png",
        "hair": "long01", "hair_colour": (70, 46, 34), "flat": 0.8, "clip": (0.5, 1.5),
        "brow": "010", "brow_colour": (74, 54, 42), "shirt": "female_casualsuit01",
        "shirt_colour": (74, 92, 104), "iris": (78, 96, 76), "lip": (0.93, 0.80, 0.79),
        "mottle": 0.6, "gain": 0.97, "saturation": 0.88, "freckles": 0.35, "creases": 0.8, "lashes": 0.75,
        "hair_to": -26.0,
    },
    "Bruno": {
        "mix": [("caucasian", "male", "young", 1)],
        "details": {**_SOFT, "eyebrows/eyebrows-trans-up": 0.3, "eyebrows/eyebrows-angle-up": 0.55},
        "skin": "young_caucasian_male/textures/young_lightskinned_male_diffuse.png",
        "hair": "short02", "hair_colour": (54, 43, 35), "flat": 0.6, "clip": (0.35, 1.7),
        "brow": "001", "brow_colour": (66, 50, 40), "shirt": "male_casualsuit01",
        "shirt_colour": (58, 74, 92), "iris": (92, 66, 44), "lip": (0.93, 0.80, 0.78),
        "mottle": 0.4, "gain": 1.02, "saturation": 0.82, "freckles": 0.3, "creases": 1.0,
        "lashes": 0.35,
    },
    "Chidi": {
        "mix": [("african", "male", "young", 1)],
        "details": {**_SOFT, "eyebrows/eyebrows-trans-up": 0.3, "eyebrows/eyebrows-angle-up": 0.9},
        "skin": "young_african_male/textures/young_darkskinned_male_diffuse.png",
        "hair": "afro01", "hair_colour": (30, 26, 23), "flat": 0.55, "clip": (0.3, 2.0),
        "brow": "008", "brow_colour": (34, 26, 20), "shirt": "male_casualsuit01",
        "shirt_colour": (118, 74, 70), "iris": (70, 48, 34), "lip": (0.97, 0.88, 0.86),
        "mottle": 0.6, "gain": 0.80, "saturation": 0.9, "freckles": 0.1, "creases": 0.9,
        "lashes": 0.4,
    },
    "Kaya": {
        "mix": [("asian", "female", "child", 0.4), ("caucasian", "female", "child", 0.6)],
        "details": {"eyes/@-eye-height2-incr": 0.2, "eyes/@-eye-height1-incr": 0.1,
                    "eyebrows/eyebrows-trans-up": 0.35, "eyebrows/eyebrows-angle-up": 0.8},
        "skin": "young_asian_female/textures/young_lightskinned_female_diffuse3.png",
        "hair": "long01", "hair_colour": (104, 74, 52), "flat": 0.9, "clip": (0.6, 1.3),
        "brow": "009", "brow_colour": (96, 74, 56), "shirt": "female_casualsuit01",
        "shirt_colour": (104, 132, 98), "iris": (88, 62, 42), "lip": (0.96, 0.86, 0.85),
        "mottle": 0.35, "gain": 0.95, "saturation": 0.88, "freckles": 0.6, "creases": 0.3,
        "lashes": 0.55, "purse": 0.68, "brow_tilt": 0.12, "hair_to": -11.0,
    },
}  # fmt: skip
