"""Accents: where shadow falls on eyes and in the mouth, and that creases follow their controls."""

import numpy as np
import pytest

from deitalk.research.poses import MOUTH_POSES, pose_values
from rig.face import IDENTITIES, build_head
from rig.face.accents import accents

PEOPLE = [identity.name for identity in IDENTITIES]


def posed(person, pose):
    head, values = build_head(person), pose_values(pose)[None]
    vertices = head.pose(values)
    return head, vertices[0], accents(head, values, vertices)[0]


@pytest.mark.parametrize("person", PEOPLE)
def test_an_open_mouth_is_darker_further_back(person):
    head, vertices, shadow = posed(person, {"CTRL_C_jaw.ty": 0.5})
    lower = head.slices["teeth_lower"]
    back = vertices[lower, 2].max() - vertices[lower, 2]
    by_depth = [shadow[lower][np.abs(back - d) < 0.5].mean() for d in (0, 1, 2, 3)]
    assert by_depth == sorted(by_depth) and by_depth[1] > by_depth[0] + 0.1
    assert by_depth[-1] > 0.75


@pytest.mark.parametrize("person", PEOPLE)
def test_teeth_that_bite_the_lip_are_lit(person):
    head, vertices, shadow = posed(person, MOUTH_POSES["F V"])
    upper = head.slices["teeth_upper"]
    middle = vertices[upper][np.abs(vertices[upper, 0]) < 0.5]
    edge = (np.abs(vertices[upper, 0]) < 0.5) & (vertices[upper, 1] < middle[:, 1].min() + 0.1)
    front = edge & (vertices[upper, 2] > vertices[upper][edge, 2].max() - 0.3)
    assert shadow[upper][front].mean() < 0.3


@pytest.mark.parametrize("person", PEOPLE)
def test_skin_has_the_mouths_shadow_inside_alone(person):
    """Vertices below 0 lie behind the lips."""
    head, vertices, shadow = posed(person, {})
    skin = head.slices["skin"]
    dark = np.flatnonzero(shadow[skin] < -0.05)
    lips = np.concatenate([lip.rim for lip in head.motion.lips])
    assert len(dark) > 300
    assert np.isin(dark, head.mouth).all()
    assert vertices[dark, 2].max() < vertices[lips, 2].max() - 0.3


@pytest.mark.parametrize("person", PEOPLE)
def test_a_lowered_lid_darkens_the_eye(person):
    means = []
    for blink in (-0.5, 0, 0.4):
        head, vertices, shadow = posed(person, {"*eye_blink.ty": blink})
        eye = head.slices["eye_L"]
        front = vertices[eye, 2] > vertices[eye, 2].max() - 0.3
        means.append(shadow[eye][front].mean())
    assert means == sorted(means) and means[2] > means[0] + 0.1


@pytest.mark.parametrize("person", PEOPLE)
def test_the_shadow_of_the_mouth_is_on_no_neck(person):
    head = build_head(person)
    skin = head.straight[head.slices["skin"]]
    teeth = head.straight[head.teeth]
    neck = skin[:, 1] < teeth[:, 1].min() - 0.6
    neck &= np.abs(skin[:, 0]) > teeth[:, 0].max() + 0.7
    assert neck.any() and not neck[head.mouth].any()
