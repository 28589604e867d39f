"""Rig targets: names in the tables, ranges, closures in every emotion."""

import csv
from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.emotions import EMOTIONS
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.articulation import BITE, CHANNELS, JAW, TOGETHER, articulate
from deitalk.research.corpus.rig_targets import (
    GAINS,
    USUAL_INTENSITY,
    act,
    channel_matrix,
    intensity_envelope,
    style_poses,
)
from deitalk.research.corpus.utterance import Phone
from rig import default_controls

CONTROLS = default_controls()
NEUTRAL = np.eye(5)[0]


def weights(emotion: str) -> np.ndarray:
    return np.eye(5)[EMOTIONS.index(emotion)]


TABLES = {
    "channels": ("deitalk.research.corpus", "tables/channels.csv"),
    "styles": ("deitalk.postprocess", "taught_poses.csv"),
}


def rows(name: str) -> list[dict[str, str]]:
    package, path = TABLES[name]
    text = resources.files(package).joinpath(path).read_text()
    return list(csv.DictReader(text.splitlines()))


def phrase(names: str = "SIL M AA P IY F UW B AO SIL", seconds: float = 0.1) -> np.ndarray:
    phones = [Phone(i * seconds, (i + 1) * seconds, n) for i, n in enumerate(names.split())]
    return articulate(phones, round(len(phones) * seconds * 60), 60.0)


def test_tables_name_known_channels_controls_and_emotions():
    spellings = {name for row in (*rows("channels"), *rows("styles")) for name in [row["control"]]}
    for pattern in spellings:
        for side in "LR" if "*" in pattern else "C":
            assert pattern.replace("*", side) in CONTROLS.names
    assert {row["channel"] for row in rows("channels")} == {*CHANNELS, "sticky"}
    assert set(EMOTIONS[1:]) <= set(rows("styles")[0]) and set(GAINS) == set(EMOTIONS)
    assert all(row["source"] for row in rows("styles")), "every row cites its action unit"
    pairs = [row["control"] for row in rows("styles")]
    assert len(pairs) == len(set(pairs)), "a doubled row would win silently"


def test_every_pose_fits_the_ranges_before_anything_is_clipped():
    posed = CONTROLS.rest + style_poses(CONTROLS)
    assert (posed <= CONTROLS.maximum + 1e-6).all() and (posed >= CONTROLS.minimum - 1e-6).all()
    full = np.abs(channel_matrix(CONTROLS)).max(axis=0)
    assert (full <= np.maximum(CONTROLS.maximum, -CONTROLS.minimum) + 1e-6).all()


def test_poses_follow_facs():
    poses = dict(zip(EMOTIONS, style_poses(CONTROLS), strict=True))

    def of(emotion: str, control: str) -> float:
        return poses[emotion][CONTROLS.index(control)]

    assert not poses["neutral"].any()
    for side in "LR":
        corner, depress = (f"CTRL_{side}_mouth_corner{x}.ty" for x in ("Pull", "Depress"))
        assert of("happy", corner) > 0.5 > of("happy", depress) == 0
        assert of("sad", depress) > 0.5 and of("sad", f"CTRL_{side}_brow_raiseIn.ty") > 0.5
        assert of("angry", f"CTRL_{side}_brow_down.ty") > 0.5 > of("sad", corner) == 0
        assert of("surprised", f"CTRL_{side}_brow_raiseOut.ty") > 0.5
        assert of("surprised", f"CTRL_{side}_eye_blink.ty") < -0.3, "negative widens the eye"
    assert of("surprised", "CTRL_C_jaw.ty") > 0


def test_emotions_differ_pairwise():
    poses = style_poses(CONTROLS)
    for i in range(5):
        for j in range(i):
            assert np.linalg.norm(poses[i] - poses[j]) > 0.8, (EMOTIONS[i], EMOTIONS[j])


def test_at_intensity_0_the_face_is_rest_and_plain_articulation():
    channels = phrase()
    faces = [act(channels, weights(e), np.zeros(len(channels)), 60, CONTROLS) for e in EMOTIONS]
    for face in faces[1:]:
        np.testing.assert_array_equal(face, faces[0])
    still = act(np.zeros((5, 13)), weights("angry"), np.zeros(5), 60, CONTROLS)
    np.testing.assert_allclose(still, np.tile(CONTROLS.rest, (5, 1)))
    jaw = faces[0][:, CONTROLS.index("CTRL_C_jaw.ty")]
    expected = channels[:, JAW] * channel_matrix(CONTROLS)[JAW, CONTROLS.index("CTRL_C_jaw.ty")]
    np.testing.assert_allclose(jaw, expected, atol=1e-6)


def test_the_face_moves_continuously_with_the_intensity():
    channels = np.tile(phrase()[18], (201, 1))
    rising = np.linspace(0, 0.2, 201)
    for emotion in EMOTIONS:
        face = act(channels, weights(emotion), rising, 60, CONTROLS)
        assert np.abs(np.diff(face, axis=0)).max() < 0.01, "no jump where the act begins"


def test_mouth_widens_with_intensity_and_more_in_joy_than_in_sadness():
    channels = phrase("SIL AA T AA SIL", 0.2)
    jaw = CONTROLS.index("CTRL_C_jaw.ty")

    def widest(emotion: str, e: float) -> float:
        return act(channels, weights(emotion), np.full(len(channels), e), 60, CONTROLS)[
            :, jaw
        ].max()

    usual = widest("neutral", USUAL_INTENSITY)
    assert widest("neutral", 0.9) > 1.1 * usual > 1.2 * widest("neutral", 0.2)
    assert 1.2 * usual < widest("happy", 1.0) < widest("angry", 1.0) < 1.5 * usual
    assert widest("happy", 0.9) > 1.05 * widest("neutral", 0.9)
    assert widest("sad", 0.9) < 0.95 * widest("neutral", 0.9)


@pytest.mark.parametrize("emotion", EMOTIONS)
@pytest.mark.parametrize("intensity", [0.0, 0.5, 1.0])
def test_closures_are_kept_in_every_emotion(emotion, intensity):
    channels = phrase()
    face = act(channels, weights(emotion), np.full(len(channels), intensity), 60, CONTROLS)
    lips = [i for i, n in enumerate(CONTROLS.names) if "lipsTogether" in n]
    shut = channels[:, TOGETHER] > 0.999
    assert shut.sum() >= 12, "three bilabials of two video frames"
    assert face[shut][:, lips].min() > 0.99
    assert face[shut, CONTROLS.index("CTRL_C_jaw.ty")].max() <= 0.12
    opening = [i for i, n in enumerate(CONTROLS.names) if "LipRaise" in n or "LipDepress" in n]
    assert face[shut][:, opening].max() < 0.02
    bitten = channels[:, BITE] > 0.999
    assert face[bitten, CONTROLS.index("CTRL_L_mouth_lipBiteD.ty")].min() > 0.7


def test_left_and_right_differ_except_contact_and_gaze():
    channels = phrase("SIL M AA P IY F UW SH B AO TH SIL")
    for emotion in EMOTIONS:
        face = act(channels, weights(emotion), np.full(len(channels), 0.8), 60, CONTROLS)
        moved = np.abs(face - CONTROLS.rest).max(axis=0)
        for i, j in enumerate(CONTROLS.mirror_index):
            name = CONTROLS.names[i]
            if i < j and moved[i] > 0.01:
                mirrored = face[:, i] * CONTROLS.mirror_sign[i]
                alike = np.abs(mirrored - face[:, j]).max() < 1e-4
                agree = any(x in name for x in ("lipsTogether", "eye.tx", "eye.ty", "pupil"))
                assert alike == agree, (emotion, name)
                assert np.abs(mirrored - face[:, j]).max() < 0.15, "but it is one face"


def test_stickiness_follows_a_closure_and_never_precedes_it():
    channels = phrase("SIL AA M AA SIL", 0.2)
    face = act(channels, NEUTRAL, np.full(len(channels), 0.5), 60, CONTROLS)
    sticky = face[:, CONTROLS.index("CTRL_L_mouth_lipSticky.ty")]
    shut = np.flatnonzero(channels[:, TOGETHER] > 0.99)
    assert sticky[: shut[0]].max() < 1e-6 and sticky[shut[-1] :].max() > 0.05
    assert sticky[-1] < 0.01


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from(PHONES), min_size=1, max_size=12),
    st.sampled_from(EMOTIONS),
    st.floats(0, 1),
    st.floats(0.03, 0.3),
)
def test_curves_are_finite_and_in_range(names, emotion, intensity, seconds):
    channels = phrase(" ".join(names), seconds)
    face = act(channels, weights(emotion), np.full(len(channels), intensity), 60, CONTROLS)
    assert face.dtype == np.float32 and face.shape == (len(channels), 185)
    assert np.isfinite(face).all()
    assert (face >= CONTROLS.minimum).all() and (face <= CONTROLS.maximum).all()
    if set(names) == {"SIL"}:
        lips = CONTROLS.subset("lip")
        posed = CONTROLS.rest + intensity * style_poses(CONTROLS)[EMOTIONS.index(emotion)]
        np.testing.assert_allclose(face[:, lips], np.tile(posed[lips], (len(face), 1)), atol=1e-5)


@settings(max_examples=100, deadline=None)
@given(st.floats(0, 3), st.floats(0.05, 3), st.floats(0, 1.5), st.floats(-2.5, 2.5))
def test_the_envelope_is_0_at_both_ends_of_any_clip(begin, length, trailing, z):
    n = int(np.ceil((begin + length + trailing) * 60))
    envelope = intensity_envelope(np.full(n, z), (begin, begin + length), 60)
    assert envelope[0] == 0 and envelope[-1] == 0
    assert (envelope >= 0).all() and (envelope <= 1).all()


def test_the_envelope_rises_before_speech_holds_and_falls_after():
    envelope = intensity_envelope(np.zeros(600), (2.0, 6.0), 60)
    assert envelope[:107].max() == 0 and envelope[120] > 0.2, "0.2 s before the first sound"
    np.testing.assert_allclose(envelope[135:360], USUAL_INTENSITY, atol=1e-9)
    assert envelope[410:].max() == 0, "0.8 s after the last sound"
    lively, dull = (intensity_envelope(np.full(600, z), (2.0, 6.0), 60)[240] for z in (1.0, -1.0))
    assert lively > USUAL_INTENSITY + 0.15 and dull < USUAL_INTENSITY - 0.15


def test_silence_has_no_intensity():
    assert not intensity_envelope(np.ones(30), None, 30).any()
    assert len(intensity_envelope(np.ones(0), (0.0, 1.0), 30)) == 0
