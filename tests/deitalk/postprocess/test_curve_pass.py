"""The pass: equal for any blocks and streams, a bounded look-ahead, gradients, constant work."""

import numpy as np
import pytest
import torch

from deitalk.audio.held_sound import first_held, follow_held
from deitalk.config.rig_file import RIGS, read_controls
from deitalk.config.rules import HoldPose, RulesConfig
from deitalk.emotions import LABELS
from deitalk.pipeline import curves as whole_pass
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.curve_pass import CurvePass, TorchPass
from deitalk.postprocess.expressions import expression_table
from deitalk.postprocess.tracks import (
    MOTION,
    N_SHOWN,
    N_VARIANTS,
    VOICE,
    VoiceTracks,
    shown_columns,
)
from rig import default_controls

CONTROLS = default_controls()
CLOSE = 3e-6  # rounding
RULES = {
    "default": RulesConfig(),
    "captures": RulesConfig.for_captures(),
    "none": RulesConfig.none(),
    "slow contacts": RulesConfig.model_validate({"limit_contact_speed": {"step": 0.1}}),
}


def inputs(batch, n_frames, seed=0, controls=CONTROLS, *, held=False):
    """Readings, voice, gates and motion, gain and flags; all that a pass takes but its state."""
    rng = np.random.default_rng(seed)
    count = len(controls)
    neutral, emotional = rng.uniform(-0.1, 1, (2, batch, n_frames, count)).astype(np.float32)
    voice = rng.uniform(0, 1.5, (batch, n_frames, VOICE)).astype(np.float32)
    voice[..., 3:5] = rng.random((batch, n_frames, 2)) < 0.1
    voice[..., -N_VARIANTS:] /= N_VARIANTS  # those of an emotion sum to 1
    voice[..., 7:9] = 0
    if held:
        voice[..., 7], voice[..., 8] = held_tracks(rng, batch, n_frames)
    shown = rng.uniform(0, 1, (batch, n_frames, N_SHOWN)).astype(np.float32)
    gain = rng.uniform(0.5, 1.5, (batch, count)).astype(np.float32)
    ruled = (np.arange(batch) % 3 < 2).astype(np.float32)
    return neutral, emotional, voice, shown, gain, ruled


def held_tracks(rng, batch, n_frames):
    """Frames since the pose, and its share, of streams that hold a sound, break it and go on."""
    levels = rng.uniform(-40, -20, (batch, n_frames, 14))
    for stream, first in enumerate(rng.integers(2, 6, batch)):
        levels[stream, first : first + 30] = levels[stream, first]
        levels[stream, first + 22] += np.linspace(-30, 30, 14)
    rule = HoldPose(frames=4)
    held, _ = follow_held(levels, np.ones((batch, n_frames)), rule, first_held(batch, 14))
    assert held.sounding.any(axis=1).all()
    return held.back, held.share


def passed(rules, given, sizes):
    """Curves of all frames, in blocks of some sizes, one after the other."""
    neutral, emotional, voice, shown, gain, ruled = given
    state, parts, at, k = rules.first(len(neutral)), [], 0, 0
    while at < neutral.shape[1]:
        rows = slice(at, at + sizes[k % len(sizes)])
        block = (part[:, rows] for part in (neutral, emotional, voice, shown))
        *found, state = rules(*block, gain, ruled, state)
        parts.append(found)
        at, k = rows.stop, k + 1
    return [np.concatenate(rows, axis=1) for rows in zip(*parts, strict=True)]


@pytest.mark.parametrize("ahead", [None, 2, 1, 0])
@pytest.mark.parametrize("rules", RULES.values(), ids=RULES)
def test_blocks_of_any_sizes_and_streams_side_by_side_give_the_same(rules, ahead):
    given = inputs(3, 60, held=True)
    numbers = TorchPass(CurvePass(CONTROLS, rules, ahead))
    expected = passed(numbers, given, [60])
    assert expected[0].std(axis=1).max() > 0.05
    for sizes in ([1], [2, 7, 1], [40]):
        for ours, theirs in zip(passed(numbers, given, sizes), expected, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=CLOSE)
    for k in range(3):
        alone = passed(numbers, [part[k : k + 1] for part in given], [60])
        for ours, theirs in zip(alone, expected, strict=True):
            np.testing.assert_allclose(ours[0], theirs[k], atol=2 * CLOSE)


@pytest.mark.parametrize("ahead", [None, 2, 1, 0])
def test_frames_depend_on_no_reading_beyond_the_look_ahead_and_none_before_the_past(ahead):
    """Contacts at rest, and one reading of 1 that everything near it sees."""
    numbers = TorchPass(CurvePass(CONTROLS, RulesConfig(), ahead))
    given = inputs(1, 60)
    other = [part.copy() for part in given]
    other[0][:, 30], other[1][:, 30] = 0.9, 0.1
    changed = np.abs(passed(numbers, given, [60])[0] - passed(numbers, other, [60])[0])
    frames = np.flatnonzero(changed[0].max(axis=-1) > 1e-5) - numbers.ahead  # what comes out
    assert 30 in frames
    assert 30 - numbers.ahead <= frames.min() <= 30 - (numbers.ahead > 0)
    assert 30 < frames.max() <= 30 + numbers.behind
    assert numbers.ahead == (6 if ahead is None else ahead)


def test_gradients_go_through_the_rules_to_both_readings():
    given = [torch.from_numpy(part) for part in inputs(2, 24)]
    for reading in given[:2]:
        reading.requires_grad_()
    rules = CurvePass(CONTROLS)
    curves, *_ = rules(*given, rules.first(2))
    curves.square().sum().backward()
    for reading in given[:2]:
        assert reading.grad.isfinite().all()
        moved = (reading.grad.abs().sum(dim=(0, 1)) > 0).float().mean()
        assert moved > 0.95, "nearly every control learns through the rules"


def test_work_does_not_grow_with_the_number_of_streams():
    rules, counts = TorchPass(CurvePass(CONTROLS, ahead=2)), []
    for batch in (4, 64):
        given = inputs(batch, 3)
        with torch.profiler.profile() as profile:
            rules(*given, rules.first(batch))
        counts.append(sum(event.count for event in profile.key_averages()))
    assert counts[1] <= 1.05 * counts[0]


@pytest.mark.parametrize("n_frames", [1, 2, 5, 6, 7, 100])
def test_a_whole_recording_in_blocks_is_that_of_one_block(n_frames, monkeypatch):
    """Gates and motion are those of the frames that come out; silence follows the last one."""
    found = []
    for block in (1000, 1, 4, 64):
        monkeypatch.setattr(whole_pass, "BLOCK_FRAMES", block)
        neutral, emotional, voice, shown, gain, _ = (part[0] for part in inputs(1, n_frames))
        rules = TorchPass(CurvePass(CONTROLS))
        clip = whole_pass.Unruled(neutral, emotional, voice, shown, gain)
        (outside,) = whole_pass.apply_rules(rules, [clip])
        found.append((emotional, neutral, outside))
    for curves, plain, outside in found[1:]:
        np.testing.assert_allclose(curves, found[0][0], atol=CLOSE)
        np.testing.assert_allclose(plain, found[0][1], atol=CLOSE)
        assert outside == found[0][2]


def test_recordings_of_any_lengths_pass_the_rules_side_by_side_as_each_alone(monkeypatch):
    monkeypatch.setattr(whole_pass, "BLOCK_FRAMES", 16)
    rules = TorchPass(CurvePass(CONTROLS))

    def clips():
        sizes = enumerate((40, 1, 16, 23, 6))
        given = [[part[0] for part in inputs(1, size, seed=seed)[:5]] for seed, size in sizes]
        return [whole_pass.Unruled(*arrays, ruled=k != 3) for k, arrays in enumerate(given)]

    together, alone = clips(), clips()
    outside = whole_pass.apply_rules(rules, together)
    assert outside == [whole_pass.apply_rules(rules, [clip])[0] for clip in alone]
    for found, expected in zip(together, alone, strict=True):
        np.testing.assert_allclose(found.shown, expected.shown, atol=CLOSE)
        np.testing.assert_allclose(found.neutral, expected.neutral, atol=CLOSE)


def test_motion_and_gates_meet_the_frame_that_comes_out():
    """Silence at frame 20 alone; the lids shut at frame 31 alone."""
    n_frames, lid = 40, CONTROLS.index("CTRL_L_eye_blink.ty")
    speech = np.tile(CONTROLS.rest, (n_frames, 1)).astype(np.float32)
    jaw = CONTROLS.index("CTRL_C_jaw.ty")
    speech[:, jaw] = 0.5
    voice = np.zeros((n_frames, VOICE), np.float32)
    voice[:, :4] = 1
    shown = np.zeros((n_frames, N_SHOWN), np.float32)
    shown[:, :2] = 1
    shown[20, 0], shown[31, 2] = 0, 1
    curves, neutral, gain = speech.copy(), speech.copy(), np.ones(len(CONTROLS), np.float32)
    rules = TorchPass(CurvePass(CONTROLS))
    whole_pass.apply_rules(rules, [whole_pass.Unruled(neutral, curves, voice, shown, gain)])
    for reading in (curves, neutral):
        assert np.flatnonzero(reading[:, jaw] == 0).tolist() == [20]
        assert np.flatnonzero(reading[:, lid] > 0.5).tolist() == [31]
    assert MOTION.lids == 2, "the lids are the first columns of the motion"


@pytest.mark.parametrize("rig", RIGS)
def test_rigs_without_contacts_pass_all_other_rules(rig):
    controls = read_controls(rig)
    given = inputs(2, 20, controls=controls)
    curves, neutral, *_ = passed(TorchPass(CurvePass(controls)), given, [20])
    assert np.isfinite(curves).all() and curves.std(axis=1).max() > 0.05
    assert (curves <= controls.maximum).all() and (neutral >= controls.minimum).all()


def finished(neutral, emotional, *, scale=1.0, held=1.0, emotion="happy", mouth=None):
    """Curves and neutral curves of a take without motion."""
    n_frames, ones = len(neutral), np.ones(len(neutral), np.float32)
    weights = np.eye(len(LABELS), dtype=np.float32)[[LABELS.index(emotion)] * n_frames]
    phones = np.zeros((n_frames, 4), np.float32)
    free, variants = 0 * ones, np.zeros((n_frames, N_VARIANTS))
    said = scale * ones, ones, held * ones, phones, weights, free, free, variants, ones, ones
    voice = VoiceTracks(*said).columns()
    gate = ones if mouth is None else mouth
    curves, plain, gain = emotional.copy(), neutral.copy(), np.ones(len(CONTROLS), np.float32)
    rules = TorchPass(CurvePass(CONTROLS))
    shown = shown_columns(gate, gate, None)
    whole_pass.apply_rules(rules, [whole_pass.Unruled(plain, curves, voice, shown, gain)])
    return curves, plain


def readings(seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (2, 50, len(CONTROLS))).astype(np.float32)


@pytest.mark.parametrize("emotion", LABELS)
def test_intensity_0_is_the_neutral_reading_after_all_rules(emotion):
    curves, plain = finished(*readings(), scale=0.0, emotion=emotion)
    np.testing.assert_array_equal(curves, plain)


@pytest.mark.parametrize("emotion", LABELS)
@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_lips_that_meet_in_the_neutral_reading_meet_after_all_rules(emotion, scale):
    neutral, emotional = readings(1)
    groups = ControlGroups(CONTROLS)
    neutral[10:13, groups.seals] = 1
    curves, plain = finished(neutral, emotional, scale=scale, emotion=emotion)
    assert (curves[10:13][:, groups.seals] > 0.99).all()
    jaw = CONTROLS.index("CTRL_C_jaw.ty")
    np.testing.assert_allclose(curves[10:13, jaw], plain[10:13, jaw], atol=1e-6)


def test_mouth_in_silence_is_at_rest_whatever_is_around_it():
    """A contact in the frame after: lips that start to close earlier are at rest in silence."""
    neutral, emotional = readings(2)
    mouth = np.ones(50, np.float32)
    mouth[20:24] = 0
    groups = ControlGroups(CONTROLS)
    seals, speaks = groups.seals, groups.follows_mouth
    neutral[24, seals] = emotional[24, seals] = 1
    for reading in finished(neutral, emotional, scale=2.0, emotion="fear", mouth=mouth):
        rest = np.tile(CONTROLS.rest[speaks], (4, 1))
        np.testing.assert_allclose(reading[20:24, speaks], rest, atol=1e-6)
        assert reading[24, seals].min() > 0.99


def test_a_pose_of_a_mood_has_its_size_after_all_rules():
    """Fear at intensity .5 on a face at rest: half of the table's stretched lips."""
    face = np.tile(CONTROLS.rest, (20, 1)).astype(np.float32)
    curves, plain = finished(face, face, scale=1.0, held=0.5, emotion="fear")
    table = expression_table(CONTROLS.names)
    name = CONTROLS.index("CTRL_L_mouth_stretch.ty")
    pose = table.poses[LABELS.index("fear"), list(table.places).index(name)]
    np.testing.assert_allclose(curves[:, name], 0.5 * pose, rtol=1e-5)
    np.testing.assert_array_equal(plain, face)
