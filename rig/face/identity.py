"""Parameters of a procedural head."""

from dataclasses import dataclass

from rig.errors import RigError

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Identity:
    """Proportions and colours of one head.

    Ratios multiply the dimensions in `rig.face.geometry`; offsets are in cm; angles in
    degrees; colours are sRGB in 0..1. The mesh has the same topology for every identity.
    """

    name: str = "Ada"
    skull_width: float = 1.0
    face_width: float = 1.0
    jaw_width: float = 1.0
    jaw_drop_cm: float = 0.0
    chin_forward_cm: float = 0.0
    chin_width: float = 1.0
    cheek: float = 1.0
    brow_ridge: float = 1.0
    eye_size: float = 1.0
    eye_spacing: float = 1.0
    eye_tilt_degrees: float = 3.0
    eye_height: float = 1.0
    nose_length: float = 1.0
    nose_width: float = 1.0
    nose_height: float = 1.0
    nose_tip_up_cm: float = 0.0
    mouth_width: float = 1.0
    mouth_lift_cm: float = 0.0
    lip_fullness: float = 1.0
    neck_width: float = 1.0
    ear_size: float = 1.0
    brow_thickness: float = 1.0
    brow_lift_cm: float = 0.0
    hair_volume_cm: float = 0.55
    hair_length_cm: float = 0.0
    hair_parting: float = 0.35
    skin: RGB = (0.86, 0.67, 0.57)
    lips: RGB = (0.72, 0.42, 0.40)
    hair: RGB = (0.23, 0.15, 0.11)
    iris: RGB = (0.33, 0.47, 0.55)
    shirt: RGB = (0.36, 0.42, 0.47)
    beard: float = 0.0
    freckles: float = 0.3
    creases: float = 0.6


IDENTITIES: tuple[Identity, ...] = (
    Identity(
        neck_width=0.86, brow_thickness=0.8, nose_length=0.9, nose_width=1.12, mouth_lift_cm=0.35,
        jaw_width=0.87, face_width=0.97, eye_size=1.1, brow_lift_cm=-0.15, chin_width=0.96,
        cheek=1.06, lip_fullness=1.08, hair_volume_cm=0.75, hair_length_cm=9.0,
        hair_parting=0.35, lips=(0.70, 0.38, 0.38), hair=(0.20, 0.125, 0.09),
    ),
    Identity(
        name="Bruno", creases=1, shirt=(0.20, 0.24, 0.30), beard=0.8, freckles=0.1,
        skull_width=1.03, face_width=1.05, jaw_width=1.1, jaw_drop_cm=0.45,
        chin_forward_cm=0.25, chin_width=1.25, brow_ridge=1.5, eye_size=0.99, eye_height=0.92,
        eye_tilt_degrees=1.0, nose_length=0.98, nose_width=1.2, nose_height=1.12,
        lip_fullness=0.82, neck_width=1.16, ear_size=1.1, brow_thickness=1.35,
        brow_lift_cm=-0.27, mouth_lift_cm=0.28, hair_volume_cm=0.4, skin=(0.84, 0.64, 0.53),
        lips=(0.70, 0.45, 0.40),
        hair=(0.12, 0.09, 0.08), iris=(0.36, 0.26, 0.17),
    ),
    Identity(
        name="Chidi", creases=0.8, shirt=(0.45, 0.36, 0.24), beard=0.45, freckles=0.0,
        skull_width=0.98, jaw_width=1, jaw_drop_cm=0.15, cheek=1.08,
        nose_width=1.41, nose_height=0.9, nose_length=0.88, mouth_width=1.06, lip_fullness=1.32,
        eye_height=0.97, eye_tilt_degrees=2.0, neck_width=1.08, brow_thickness=1.1,
        mouth_lift_cm=0.28, eye_size=1.06, brow_lift_cm=-0.12, hair_volume_cm=0.3,
        hair_parting=0.0, skin=(0.43, 0.28, 0.21), lips=(0.47, 0.26, 0.24),
        hair=(0.06, 0.05, 0.05), iris=(0.24, 0.15, 0.10),
    ),
    Identity(
        name="Dana", creases=0.55, shirt=(0.52, 0.27, 0.26), beard=0, freckles=0.5,
        skull_width=0.97, face_width=0.95, jaw_width=0.84, jaw_drop_cm=-0.3,
        chin_width=0.82, cheek=1.05, brow_ridge=0.5, eye_size=1.1, eye_height=1.05,
        eye_tilt_degrees=5.0, nose_length=0.86, nose_width=0.94, nose_tip_up_cm=0.2,
        lip_fullness=1.18, neck_width=0.84, ear_size=0.92, brow_thickness=0.75, brow_lift_cm=0.03,
        mouth_lift_cm=0.28, hair_volume_cm=0.9, hair_length_cm=7.5, skin=(0.89, 0.72, 0.63),
        lips=(0.76, 0.40, 0.40),
        hair=(0.36, 0.19, 0.10), iris=(0.30, 0.45, 0.33),
    ),
    Identity(
        name="Emi", creases=0.5, shirt=(0.42, 0.45, 0.42), beard=0, freckles=0.1,
        face_width=1.04, jaw_width=0.89, jaw_drop_cm=-0.35, cheek=1.14,
        brow_ridge=0.35, eye_height=0.84, eye_tilt_degrees=6.0, eye_spacing=1.02,
        nose_length=0.85, nose_height=0.78, nose_width=1.09, mouth_width=0.94, lip_fullness=1.06,
        neck_width=0.86, ear_size=0.95, brow_thickness=0.85, brow_lift_cm=-0.02,
        mouth_lift_cm=0.28, eye_size=1.06, hair_volume_cm=0.7, hair_length_cm=5.0,
        hair_parting=0.0, skin=(0.88, 0.73, 0.61),
        hair=(0.07, 0.06, 0.07), iris=(0.22, 0.14, 0.09),
    ),
    Identity(
        name="Farid", creases=1, shirt=(0.27, 0.31, 0.27), beard=1.0, freckles=0.0,
        face_width=0.96, jaw_width=0.97, jaw_drop_cm=0.5, chin_forward_cm=0.15,
        brow_ridge=1.25, nose_length=1.03, nose_height=1.22, nose_width=1.09,
        nose_tip_up_cm=-0.15, lip_fullness=0.92, eye_height=0.98, brow_thickness=1.5,
        brow_lift_cm=-0.22, neck_width=1.05, skin=(0.70, 0.50, 0.39), lips=(0.62, 0.38, 0.34),
        hair=(0.08, 0.07, 0.07), iris=(0.28, 0.18, 0.11), mouth_lift_cm=0.28, eye_size=1.06,
        hair_volume_cm=0.75,
    ),
    Identity(
        name="Greta", creases=1, shirt=(0.30, 0.36, 0.48), beard=0, freckles=0.4,
        face_width=1.1, jaw_width=1.01, jaw_drop_cm=-0.15, cheek=1.28,
        chin_width=1.1, brow_ridge=0.7, eye_size=1.03, nose_width=1.16, nose_tip_up_cm=0.15,
        nose_length=0.86, mouth_width=1.04, lip_fullness=0.95, neck_width=1.05,
        brow_thickness=0.8, mouth_lift_cm=0.28, brow_lift_cm=-0.12, hair_volume_cm=1.0,
        hair_length_cm=3.0, hair_parting=-0.35,
        skin=(0.90, 0.70, 0.62), lips=(0.76, 0.45, 0.43), hair=(0.62, 0.60, 0.58),
        iris=(0.36, 0.50, 0.60),
    ),
    Identity(
        name="Hugo", creases=0.9, shirt=(0.36, 0.33, 0.30), beard=0.3, freckles=0.6,
        skull_width=0.95, face_width=0.9, jaw_width=0.85, jaw_drop_cm=0.65,
        chin_width=0.9, chin_forward_cm=-0.2, cheek=0.86, brow_ridge=1.1, eye_size=1.08,
        eye_spacing=0.96, nose_length=1.01, nose_width=0.96, nose_height=1.1, mouth_width=0.96,
        lip_fullness=0.8, neck_width=0.88, ear_size=1.15, mouth_lift_cm=0.28, brow_lift_cm=-0.12,
        hair_volume_cm=1.2,
        hair_parting=-0.4, skin=(0.90, 0.74, 0.66), lips=(0.75, 0.50, 0.47),
        hair=(0.52, 0.30, 0.14), iris=(0.32, 0.46, 0.42),
    ),
    Identity(
        name="Imani", creases=0.5, shirt=(0.58, 0.46, 0.26), beard=0, freckles=0.0,
        skull_width=0.97, face_width=0.98, jaw_width=0.87, jaw_drop_cm=-0.1,
        chin_width=0.9, cheek=1.12, brow_ridge=0.45, eye_size=1.11, eye_height=1.08,
        eye_tilt_degrees=5.0, nose_width=1.26, nose_height=0.88, nose_length=0.86,
        lip_fullness=1.36, mouth_width=1.02, neck_width=0.82, ear_size=0.9, brow_thickness=0.8,
        brow_lift_cm=0, mouth_lift_cm=0.28, hair_volume_cm=1.5, hair_parting=0.0,
        skin=(0.52, 0.34, 0.26),
        lips=(0.52, 0.25, 0.26), hair=(0.07, 0.05, 0.05), iris=(0.20, 0.13, 0.09),
    ),
    Identity(
        name="Jun", shirt=(0.24, 0.26, 0.29), beard=0.3, freckles=0.0, skull_width=1.02,
        face_width=1.03, jaw_width=0.99, jaw_drop_cm=0.1,
        cheek=1.05, brow_ridge=0.7, eye_height=0.8, eye_tilt_degrees=5.0, nose_height=0.86,
        nose_width=1.16, lip_fullness=0.94, neck_width=1.04, brow_thickness=1.05,
        nose_length=0.92, mouth_lift_cm=0.28, eye_size=1.06, brow_lift_cm=-0.12,
        hair_volume_cm=1.1, hair_parting=0.4, skin=(0.83, 0.66, 0.53), lips=(0.68, 0.43, 0.38),
        hair=(0.06, 0.06, 0.07), iris=(0.20, 0.13, 0.08),
    ),
    Identity(
        name="Kaya", creases=0.25, shirt=(0.62, 0.50, 0.28), beard=0, freckles=0.7,
        skull_width=1.05, jaw_width=0.84, jaw_drop_cm=-1.9, chin_forward_cm=-0.55,
        chin_width=0.72, cheek=1.3, brow_ridge=0.0, eye_size=1.2, eye_height=1.06,
        eye_tilt_degrees=2.0, nose_length=0.74, nose_width=0.84, nose_height=0.5,
        nose_tip_up_cm=0.25, mouth_width=0.8, mouth_lift_cm=0.45, lip_fullness=1.05,
        neck_width=0.62, brow_thickness=0.6, brow_lift_cm=0.1, hair_volume_cm=0.9,
        hair_length_cm=5.5, hair_parting=0.2, skin=(0.90, 0.72, 0.62), lips=(0.80, 0.48, 0.46),
        hair=(0.34, 0.20, 0.11), iris=(0.36, 0.28, 0.17),
    ),
    Identity(
        name="Leo", creases=0.25, shirt=(0.28, 0.42, 0.44), beard=0, freckles=0.2,
        skull_width=1.05, jaw_width=0.9, jaw_drop_cm=-1.5, chin_forward_cm=-0.55,
        chin_width=0.76, cheek=1.3, brow_ridge=0.1, eye_size=1.14, eye_height=1.04,
        eye_tilt_degrees=2.0, nose_length=0.8, nose_width=0.86, nose_height=0.62,
        nose_tip_up_cm=0.22, mouth_width=0.86, mouth_lift_cm=0.35, lip_fullness=0.95,
        neck_width=0.68, ear_size=1.12, brow_thickness=0.8, brow_lift_cm=0.1, hair_volume_cm=1.0,
        hair_parting=-0.3, skin=(0.80, 0.58, 0.46), lips=(0.70, 0.42, 0.38),
        hair=(0.10, 0.07, 0.06), iris=(0.24, 0.16, 0.10),
    ),
)  # fmt: skip
"""Ten adults and two children (Kaya and Leo); index 0 is the reference head."""
ROLES = {"female": "Dana", "male": "Bruno", "child": "Kaya"}
"""Heads that stand for a kind of person."""


def resolve_identity(identity: int | str | Identity) -> Identity:
    """Turn a number, a name, a role or an `Identity` into an `Identity`.

    Raises
    ------
    RigError
        For an unknown number or name.
    """
    if isinstance(identity, Identity):
        return identity
    word = str(identity).lower()
    word = ROLES.get(word, word).lower()
    for number, known in enumerate(IDENTITIES):
        if word in (str(number), known.name.lower()):
            return known
    names = ", ".join((*ROLES, *(known.name for known in IDENTITIES)))
    raise RigError(
        f"identity {identity!r} is unknown; use 0 to {len(IDENTITIES) - 1} or one of {names}"
    )
