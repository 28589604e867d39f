"""Scores on captures, by hand and at their limits."""

import numpy as np
import pytest

from deitalk.data.clips import read_clips
from deitalk.evaluation.comparison import CaptureSet, mean_pose
from rig import default_controls
from tests.dataset import JAW, jaw, write_dataset

CONTROLS = default_controls()
PLACE = CONTROLS.index(JAW)
EVERYTHING = np.ones(len(CONTROLS), bool)


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> CaptureSet:
    folder = write_dataset(tmp_path_factory.mktemp("data"))
    pose = mean_pose(read_clips(folder, "train"), CONTROLS, EVERYTHING)
    return CaptureSet.of(read_clips(folder, "validation"), CONTROLS, pose, EVERYTHING)


def test_mean_pose_is_the_mean_over_all_frames(captures):
    """The jaw is 0.6 in bursts; two of the lips-together controls are shut outside of them."""
    assert captures.pose.values[PLACE] == pytest.approx(0.6 * jaw().mean(), abs=1e-3)
    still = np.flatnonzero(~captures.pose.moving)
    assert captures.pose.moving.sum() == 3 and captures.pose.moving[PLACE]
    np.testing.assert_allclose(captures.pose.values[still], CONTROLS.rest[still], atol=1e-3)


def test_error_is_1_for_the_mean_pose_and_0_for_the_capture(captures):
    targets = [example.curves for example in captures.examples]
    still = [np.tile(captures.pose.values, (len(target), 1)) for target in targets]
    perfect, mean = captures.score_curves(targets), captures.score_curves(still)
    assert perfect["error_of_mean_pose"] == 0 and perfect["score"] == 1
    assert perfect["mean_r"] == pytest.approx(1) and perfect["range"] == pytest.approx(1)
    assert mean["error_of_mean_pose"] == pytest.approx(1, abs=1e-6) and np.isnan(mean["mean_r"])
    # halfway between both: a quarter of the squared error, half of the range, the same r
    half = [(a + b) / 2 for a, b in zip(targets, still, strict=True)]
    middle = captures.score_curves(half)
    assert middle["error_of_mean_pose"] == pytest.approx(0.25, abs=1e-4)
    assert middle["error_at_best_gain"] == pytest.approx(0, abs=1e-6)
    assert middle["range"] == pytest.approx(0.5) and middle["mean_r"] == pytest.approx(1)


def test_best_gain_leaves_what_is_not_correlated(captures):
    """1 - r² of the spread around the own mean; curves that move against the capture explain 0."""
    targets = [example.curves for example in captures.examples]
    joined = np.concatenate(targets)[:, captures.pose.moving].astype(np.float64)
    spread = np.square(joined - joined.mean(axis=0)).sum()
    still = np.square(joined - captures.pose.values[captures.pose.moving]).sum()
    against = captures.score_curves([1 - target for target in targets])
    assert against["error_at_best_gain"] == pytest.approx(spread / still)
    noise = np.random.default_rng(0).normal(0, joined.std(axis=0).max(), joined.shape)
    given = np.concatenate(targets)
    given[:, captures.pose.moving] = noisy = 0.3 + 2 * (joined + noise)
    r = np.array([np.corrcoef(a, b)[0, 1] for a, b in zip(joined.T, noisy.T, strict=True)])
    expected = ((1 - r**2) * np.square(joined - joined.mean(axis=0)).sum(axis=0)).sum() / still
    places = np.cumsum([len(target) for target in targets])[:-1]
    found = captures.score_curves(np.split(given, places))
    assert found["error_at_best_gain"] == pytest.approx(expected, rel=1e-3)


def test_unknown_controls_do_not_count(captures):
    known = EVERYTHING.copy()
    known[PLACE] = False
    blind = [example._replace(known=known) for example in captures.examples]
    wrong = [example.curves.copy() for example in captures.examples]
    for curves in wrong:
        curves[:, PLACE] = 1 - curves[:, PLACE]
    partial = CaptureSet(tuple(blind), CONTROLS, captures.pose, EVERYTHING)
    assert partial.score_curves(wrong)["error_of_mean_pose"] == 0
    assert captures.score_curves(wrong)["error_of_mean_pose"] > 0.5
