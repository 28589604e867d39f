"""Who is made: targets of the base mesh, parts and colours. Units of colours: sRGB, 0 to 255.

Hair has a style, a shift of the hairline's front and least height of the sideburns, and layers of
cards from the outside to the scalp: how many, their length, height over the scalp, width and end
(``cut``), cm of the average head, and where within the hairline (``from``, ``to``), round the
head (``around``, degrees) and from the parting (``part``) they are rooted. ``inset`` leaves out the
thin sides of a lock's picture. Strands fade at their roots (``fade``, of locks and wisps) and
``tips``, shares of their length, and begin up to ``starts`` of it late; they are ``thick`` (least,
greatest) texels of 64 and ``gather`` to the middles of ``locks`` in a card, which is ``narrow`` at its
root and by its ``taper`` at its end, and whose locks bend ``bends`` radians along it. A layer may ``wave`` and ``fan`` out (cm), and its cut
sink by ``arc`` at 4 cm from the middle. ``volume`` is what hair rises at the sides, in lifts; ``least`` is the darkest tone of a card,
``roots`` how far the drawn roots lie before the hairline, which is ``soft`` over so many cm and
whose strokes lie aslant by ``slant``, and whose drawn line wanders by ``uneven``, for 1 of `strands.uneven`;
``part_share`` is how much of the scalp a parting shows. ``hairline`` is a line of the person's own, ``arch`` the least height of the line over ears.

Coils have a radius (``coil``) and ``surfaces``, heights of which the longest is 1, shorter at the ``sides``; over
``edges``, cm by degrees round the head, they thin out to the hairline. ``root_colour`` is that of drawn roots.

Of the skin ``drawing`` is how much of the source's own fine drawing is kept, ``flush`` how much blood colours zones of the face, ``mottle`` the strength of its
noise, ``patches`` the share of its broad ones (1 unless given) and ``flesh`` the colour of the corners of the eyes; ``gain`` is a power of its colours (of all, or of red,
green and blue) and ``oil`` what its gloss has more; ``lip`` is a factor on the picture's mean colour
of lips, ``enamel``, ``gum`` and ``mucosa`` are colours in the mouth (0 to 1). ``brow_hairs`` are how dense the hairs of
a brow and the soft ground below them are. ``lids`` is how much higher the upper and the lower lid are than the package's, cm. ``shades`` are the darkest and lightest strands,
``lash_length`` the length of lashes, for 1 of the package's.
"""

_SOFT = {"eyes/@-eye-height2-incr": 0.35, "eyes/@-eye-height1-incr": 0.2}

PEOPLE = {
    "Ada": {
        "lids": (-0.04, 0.04), "mix": [("caucasian", "female", "young", 0.85), ("asian", "female", "young", 0.15)],
        "details": {**_SOFT, "eyebrows/eyebrows-angle-up": 0.45, "eyebrows/eyebrows-trans-up": 0.35,
                    "mouth/mouth-angles-up": 0.25},
        "skin": "young_caucasian_female/textures/young_lightskinned_female_diffuse2.png",
        "shine": 0.5, "hair_colour": (104, 70, 50),
        "brow": "001", "brow_colour": (74, 54, 42), "shirt": "female_casualsuit01",
        "shirt_colour": (74, 92, 104), "iris": (74, 80, 68), "lip": (0.855, 0.815, 0.805),
        "drawing": 0.55, "mottle": 0.6, "gain": (0.955, 0.985, 1.01), "saturation": 0.96, "oil": 0.03, "flush": 0.42, "freckles": 0.35, "creases": 0.8, "lashes": 0.5,
        "style": "long", "ends": 0.66, "tips": 0.26, "line": -0.9, "burns": 3.0, "arch": 5.4, "parting": 1.6, "falls": 2.5, "root": 0.7, "hairs": 30, "thick": (1.3, 2.3),
        "locks": 5, "gather": 0.4, "bends": 7, "slant": 1.2, "narrow": 0.6, "starts": 0.09, "soft": 1.6, "uneven": 0.8, "part_share": 0.26, "brow_hairs": (0.85, 0.22),
        "curl": 0.4, "scalp": 0.9, "volume": 1.15, "fade": (0.09, 0.3), "least": 0.7, "roots": 0.7,
        "layers": [
            {"count": 44, "length": 22, "lift": 1.25, "width": 0.6, "from": 0.8, "wave": 0.5, "steps": 9,
             "cut": -12.0, "ends": 2.5, "roll": 1.0, "stray": 0.25, "wisps": True},
            {"count": 70, "length": 9, "lift": 0.75, "rise": 1.5, "width": 0.8, "from": 0.5, "part": 0.5, "around": (0, 120), "tone": 0.98,
             "steps": 5, "roll": 0.08, "stray": 0.07},
            {"count": 50, "style": "frame", "around": (0, 50), "length": 26, "lift": 0.85, "rise": 1.8, "width": 0.9, "from": 0.8, "to": 5, "part": 2.6,
             "wave": 0.4, "fan": 0.6, "steps": 11, "cut": -11.4, "ends": 1.5, "taper": 0.5, "roll": 0.15, "stray": 0.06},
            {"count": 170, "length": 30, "lift": 1.0, "rise": 2.0, "width": 1.2, "from": 1.0, "wave": 0.45, "fan": 0.6, "steps": 9,
             "cut": -13.4, "ends": 1.8, "taper": 0.4, "roll": 0.2, "stray": 0.06},
            {"count": 60, "around": (0, 65), "length": 30, "lift": 0.8, "rise": 2.0, "width": 1.2, "from": 0.5, "to": 4, "wave": 0.4, "fan": 0.6, "tone": 0.97,
             "steps": 9, "cut": -13.4, "ends": 1.6, "taper": 0.5, "roll": 0.2, "stray": 0.05},
            {"count": 50, "style": "frame", "around": (8, 62), "length": 17, "lift": 0.6, "width": 0.5, "from": 0.3, "to": 2.5, "wave": 0.4, "steps": 8,
             "cut": -8.0, "ends": 2.5, "roll": 0.2, "stray": 0.2, "wisps": True},
            {"count": 60, "length": 28, "lift": 0.4, "width": 1.7, "from": 0.4, "around": (48, 145), "tone": 0.85, "steps": 8,
             "cut": -13.4, "ends": 1.4, "taper": 0.4, "roll": 0.15, "stray": 0.06},
            {"count": 60, "length": 26, "lift": 0.3, "width": 1.9, "from": 1.4, "tone": 0.75, "steps": 7, "cut": -12.9, "ends": 1.4, "taper": 0.4,
             "roll": 0.1, "stray": 0.05},
            {"count": 260, "length": 2.2, "lift": 0.14, "width": 0.4, "from": -0.35, "to": 0.9, "steps": 2, "around": (0, 80),
             "wisps": True, "stray": 0.45, "up": 0.12},
        ],
    },
    "Bruno": {
        "lids": (0.06, 0.04), "mix": [("caucasian", "male", "young", 1)],
        "details": {**_SOFT, "eyebrows/eyebrows-trans-up": 0.3, "eyebrows/eyebrows-angle-up": 0.55},
        "skin": "young_caucasian_male/textures/young_lightskinned_male_diffuse.png",
        "shine": 0.34, "hair_colour": (50, 38, 30),
        "brow": "001", "brow_colour": (66, 50, 40), "shirt": "male_casualsuit01",
        "shirt_colour": (58, 74, 92), "iris": (62, 48, 37), "lip": (0.80, 0.875, 0.87),
        "drawing": 0.28, "mottle": 0.55, "patches": 0.2, "gain": 1.06, "saturation": 0.86, "flush": 0.28, "oil": 0.02, "freckles": 0.3, "creases": 1.0,
        "lashes": 0.6, "lash_length": 0.5,
        "style": "short", "ends": 0.55, "line": -0.2, "burns": 0.0, "beard": 0.36, "sweep": -1.0, "root": 0.6, "hairs": 24, "thick": (0.9, 1.5), "locks": 8, "gather": 0.2, "shades": (0.75, 1.2), "tips": 0.3,
        "slant": 0.3, "soft": 1.6, "least": 0.8, "roots": 0.55, "root_colour": (50, 37, 28), "brow_hairs": (1.3, 0.35), "fade": (0.2, 0.3), "narrow": 0.7, "curl": 0.6, "scalp": 0.95,
        "layers": [
            {"count": 300, "length": 4.6, "lift": 1.4, "width": 0.35, "sides": 0.4, "wisps": True, "stray": 0.3, "steps": 3, "up": 0.5},
            {"count": 520, "length": 5.0, "lift": 1.2, "width": 0.7, "sides": 0.4, "stray": 0.2, "steps": 4, "from": 0.6, "up": 0.5, "roll": 0.25},
            {"count": 420, "length": 4.0, "lift": 0.75, "width": 0.7, "sides": 0.42, "stray": 0.2, "steps": 3, "from": 0.45, "up": 0.35, "tone": 0.9, "roll": 0.2},
            {"count": 560, "length": 2.8, "lift": 0.4, "width": 0.7, "sides": 0.7, "stray": 0.5, "steps": 2, "from": 0.15, "up": 0.3, "tone": 0.85, "roll": 0.15},
            {"count": 500, "length": 1.6, "lift": 0.25, "width": 0.4, "from": -0.2, "to": 0.8, "steps": 2,
             "wisps": True, "stray": 0.3, "up": 0.3, "back": 1.0, "sides": 0.7},
        ],
    },
    "Chidi": {
        "lids": (0.06, 0.04), "mix": [("african", "male", "young", 0.8), ("caucasian", "male", "young", 0.2)],
        "details": {**_SOFT, "eyebrows/eyebrows-trans-up": 0.3, "eyebrows/eyebrows-angle-up": 0.6,
                    "mouth/mouth-lowerlip-volume-decr": 0.7, "mouth/mouth-upperlip-volume-decr": 0.6,
                    "mouth/mouth-lowerlip-height-decr": 0.45, "mouth/mouth-upperlip-height-decr": 0.3},
        "skin": "young_african_male/textures/young_darkskinned_male_diffuse.png",
        "shine": 0.3, "hair_colour": (40, 33, 28),
        "brow": "008", "brow_tilt": -0.13, "brow_hairs": (1.4, 0.6), "brow_colour": (34, 26, 20), "shirt": "male_casualsuit01",
        "shirt_colour": (118, 74, 70), "iris": (48, 35, 27), "lip": (0.90, 0.76, 0.72), "enamel": (0.82, 0.78, 0.725), "gum": (0.62, 0.39, 0.37), "mucosa": (0.58, 0.33, 0.31), "white": (0.655, 0.60, 0.54),
        "drawing": 0.55, "mottle": 0.75, "patches": 0.2, "gain": (0.82, 0.82, 0.845), "saturation": 1.08, "flush": 0.15, "oil": 0.05, "freckles": 0.1, "flesh": (0.60, 0.49, 0.44), "creases": 0.9,
        "lashes": 0.65, "lash_length": 0.5,
        "style": "coils", "root_colour": (32, 24, 19), "ends": 0.75, "line": 0.0, "burns": 0.0, "beard": 0.42, "sweep": -0.1, "root": 0.9, "hairs": 7, "thick": (0.7, 1.1), "locks": 2, "gather": 0.0,
        "hairline": [(0, 9.55), (14, 9.45), (24, 9.1), (31, 8.65), (36, 8.1), (41, 7.4), (47, 6.65), (55, 5.75), (61, 4.8), (65, 3.2), (68, 1.2), (72, 0.9), (78, 0.7),
                     (81, 2.6), (85, 4.6), (97, 4.8), (102, 3.8), (108, 1.0), (116, -1.6), (128, -3.4), (152, -4.3), (180, -4.6)],
        "edges": [(0, 1.8), (36, 1.8), (50, 2.0), (70, 2.6), (105, 3.0), (180, 3.5)], "coil": 0.12, "sides": 0.4, "surfaces": (0.9, 0.7, 0.48, 0.28, 0.1),
        "slant": 0.0, "soft": 1.0, "roots": 0.4, "curl": 2.5, "fade": (0.1, 0.1), "scalp": 0.9,
        "layers": [
            {"count": 190, "length": 0.35, "lift": 0.3, "width": 0.3, "stray": 1.0, "up": 0.6, "steps": 1, "rise": 0.4, "roll": 1.5, "from": 0.35, "to": 0.9, "around": (0, 66), "wisps": True},
            {"count": 890, "length": 0.5, "lift": 1.2, "width": 0.5, "stray": 0.8, "up": 1.2, "steps": 1, "sides": 0.4, "rise": 0.4, "roll": 1.5, "from": 0.5},
        ],
    },
    "Kaya": {
        "lids": (-0.08, 0.0), "mix": [("asian", "female", "child", 0.4), ("caucasian", "female", "child", 0.6)],
        "details": {
                    "eyebrows/eyebrows-trans-up": 0.35, "eyebrows/eyebrows-angle-up": 0.6},
        "skin": "young_asian_female/textures/young_lightskinned_female_diffuse3.png",
        "shine": 0.5, "hair_colour": (120, 87, 60),
        "brow": "001", "brow_colour": (96, 72, 52), "shirt": "female_casualsuit01",
        "shirt_colour": (104, 132, 98), "iris": (79, 58, 44), "lip": (0.865, 0.87, 0.87),
        "mottle": 0.4, "gain": (0.955, 0.985, 1.01), "saturation": 0.95, "oil": 0.03, "flush": 0.46, "freckles": 0.6, "creases": 0.3,
        "lashes": 0.35, "lash_length": 0.85, "purse": 0.68, "drawing": 0.6, "brow_tilt": -0.04, "brow_hairs": (0.75, 0.2),
        "style": "long", "ends": 0.66, "tips": 0.26, "line": -0.5, "burns": 3.0, "arch": 5.4, "parting": 0.0, "falls": 2.5, "root": 0.72, "hairs": 30, "thick": (1.3, 2.3),
        "locks": 5, "gather": 0.4, "bends": 7, "slant": 1.0, "narrow": 0.6, "starts": 0.09, "soft": 1.6, "uneven": 0.8, "part_share": 0.18,
        "curl": 0.4, "scalp": 0.9, "volume": 1.1, "fade": (0.09, 0.3), "least": 0.7, "roots": 0.6,
        "layers": [
            {"count": 40, "length": 20, "lift": 1.2, "width": 0.6, "from": 1.2, "wave": 0.4, "steps": 8,
             "cut": -9.0, "ends": 2.0, "roll": 1.0, "stray": 0.25, "wisps": True},
            {"count": 60, "length": 7.4, "lift": 0.75, "rise": 1.5, "width": 0.6, "from": 0.5, "to": 3.6, "around": (0, 60),
             "style": "fringe", "steps": 5, "roll": 0.3, "stray": 0.25, "cut": 5.2, "arc": 1.0, "ends": 0.9, "wisps": True},
            {"count": 150, "length": 7.2, "lift": 0.68, "rise": 1.5, "width": 0.85, "taper": 0.5, "from": 0.5, "to": 3.6, "around": (0, 56),
             "style": "fringe", "steps": 4, "roll": 0.12, "stray": 0.28, "cut": 5.1, "arc": 1.0, "ends": 0.9},
            {"count": 120, "length": 6.6, "lift": 0.5, "rise": 1.5, "width": 0.95, "taper": 0.5, "from": 0.5, "to": 3.4, "around": (0, 54), "tone": 0.94,
             "style": "fringe", "steps": 4, "roll": 0.1, "stray": 0.22, "cut": 5.6, "arc": 1.0, "ends": 0.7},
            {"count": 70, "length": 9, "lift": 0.8, "rise": 1.5, "width": 0.8, "from": 2.2, "part": 0.5, "around": (0, 120), "tone": 0.98,
             "steps": 5, "roll": 0.08, "stray": 0.07},
            {"count": 150, "length": 26, "lift": 0.95, "rise": 2.0, "width": 1.2, "from": 2.4, "part": 5, "wave": 0.35, "fan": 0.5, "steps": 9,
             "cut": -10.4, "ends": 1.5, "taper": 0.4, "roll": 0.2, "stray": 0.06},
            {"count": 24, "length": 22, "lift": 0.75, "rise": 2.0, "width": 0.9, "from": 0.6, "to": 4, "around": (35, 66), "wave": 0.35, "fan": 1.0, "tone": 0.97,
             "steps": 8, "cut": -5.5, "ends": 2.5, "taper": 0.8, "roll": 0.2, "stray": 0.1},
            {"count": 40, "length": 26, "lift": 0.75, "rise": 2.0, "width": 1.1, "from": 0.6, "to": 4, "around": (66, 110), "wave": 0.35, "fan": 0.8, "tone": 0.97,
             "steps": 8, "cut": -10.4, "ends": 1.5, "taper": 0.5, "roll": 0.2, "stray": 0.05},
            {"count": 50, "length": 18, "lift": 0.6, "width": 0.5, "from": 0.3, "to": 2.5, "around": (40, 66), "wave": 0.35, "steps": 7,
             "cut": -6.5, "ends": 2.0, "roll": 0.2, "stray": 0.15, "wisps": True},
            {"count": 54, "length": 24, "lift": 0.4, "width": 1.6, "from": 0.4, "around": (48, 145), "tone": 0.85, "steps": 8,
             "cut": -10.2, "ends": 1.2, "taper": 0.4, "roll": 0.15, "stray": 0.06},
            {"count": 60, "length": 22, "lift": 0.3, "width": 1.8, "from": 1.2, "tone": 0.75, "steps": 7, "cut": -9.6,
             "ends": 1.2, "taper": 0.4, "roll": 0.1, "stray": 0.05},
            {"count": 200, "length": 2.0, "lift": 0.12, "width": 0.4, "from": -0.3, "to": 0.8, "steps": 2, "around": (20, 80),
             "wisps": True, "stray": 0.4},
        ],
    },
}  # fmt: skip
