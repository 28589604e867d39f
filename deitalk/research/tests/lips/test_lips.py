"""Measured lips: the head's measures, the reader, fitted curves and the dataset folder."""

import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest
import soundfile as sf
import torch

from deitalk.data.checks import inspect_dataset
from deitalk.data.clips import read_clips
from deitalk.data.windows import cut, load_clip
from deitalk.errors import DataError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.evaluation.lips import as_markdown, evaluate
from deitalk.research.lips.dataset import write_lip_dataset
from deitalk.research.lips.fit import LOOSENESS, fit_curves, looseness
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.lips.measured import COLUMNS, read_lips
from deitalk.research.lips.transfer import CONTACT, LipRidge, LipTransfer
from rig import default_controls, limits, read_curves
from rig.errors import ExistsError
from rig.face.head import build_head
from tests.dataset import write_dataset
from tests.errors import one_line

CONTROLS = default_controls()
PLACE = {name: i for i, name in enumerate(CONTROLS.names)}
REST = torch.tensor(CONTROLS.rest).float()


@pytest.fixture(scope="module", params=[0, 2])
def head(request):
    return build_head(request.param)


@pytest.fixture(scope="module")
def lips():
    return HeadLips(build_head())


def posed(**values: float) -> torch.Tensor:
    """Rest but for some controls; ``_`` stands for both sides."""
    curves = REST.clone()
    for name, value in values.items():
        for i, control in enumerate(CONTROLS.names):
            if name in control:
                curves[i] = value
    return curves


def measured_on_mesh(head, values):
    """The six measures from the vertices of the posed head."""
    vertices, marks = head.pose(values), head.landmarks
    middle = np.abs(np.linspace(-1, 1, len(head.motion.fade))) <= 0.5
    upper, lower = (
        (lip.weight @ vertices[:, lip.rim])[:, middle].mean(axis=1) for lip in head.motion.lips
    )
    nose, chin, left, right = (
        vertices[:, marks[n]]
        for n in ("nose_base", "chin", "mouth_corner_left", "mouth_corner_right")
    )
    return np.stack(
        [
            upper[:, 1] - lower[:, 1],
            np.linalg.norm(chin - nose, axis=1),
            np.linalg.norm(left - right, axis=1),
            nose[:, 1] - upper[:, 1],
            nose[:, 1] - lower[:, 1],
            nose[:, 1] - (left[:, 1] + right[:, 1]) / 2,
        ],
        axis=1,
    )


def test_measures_are_those_of_the_posed_head(head, rng):
    names = [n for n in CONTROLS.names if ("mouth" in n or "jaw" in n) and "openExtreme" not in n]
    values = np.tile(CONTROLS.rest, (40, 1))
    for row in values[1:]:  # three controls at once, as speech and expression mix them
        for name in rng.choice(names, 3, replace=False):
            low, high = CONTROLS.minimum[PLACE[name]], CONTROLS.maximum[PLACE[name]]
            row[PLACE[name]] = rng.uniform(low, high)
        row[PLACE["CTRL_C_jaw.ty"]] = rng.uniform(0, 0.6)
    given = HeadLips(head)(torch.from_numpy(values).float()).numpy()
    error = np.abs(given - measured_on_mesh(head, values))
    assert np.median(error, axis=0).max() < 0.002  # cm; teeth push lips forward, not up
    assert np.quantile(error, 0.9, axis=0).max() < 0.05


def test_measures_follow_the_anatomy(lips):
    rest, given = lips(REST), dict(zip(MEASURES, range(6), strict=True))
    change = {
        name: (lips(curves) - rest).tolist()
        for name, curves in {
            "jaw": posed(**{"C_jaw.ty": 0.5}),
            "together": posed(**{"C_jaw.ty": 0.5, "lipsTogether": 1.0}),
            "wide": posed(**{"mouth_stretch.ty": 1.0}),
            "purse": posed(purse=1.0),
            "smile": posed(cornerPull=1.0),
            "raise": posed(upperLipRaise=1.0),
        }.items()
    }
    assert change["jaw"][given["opening"]] > 0.5 and change["jaw"][given["jaw"]] > 0.5
    shut = posed(**{"C_jaw.ty": 0.5, "lipsTogether": 1.0})
    assert abs(lips(shut)[given["opening"]]) < 1e-4
    assert change["together"][given["jaw"]] == pytest.approx(change["jaw"][given["jaw"]], abs=1e-4)
    assert change["wide"][given["width"]] > 0.2 > -0.2 > change["purse"][given["width"]]
    assert change["smile"][given["corner"]] < -0.1  # a smaller distance below the nose
    assert change["raise"][given["upper_lip"]] < -0.1


def test_gradient_agrees_with_finite_differences(lips):
    point = posed(**{"C_jaw.ty": 0.3, "lipsTogether": 0.4, "funnel": 0.3}).double()
    exact = lips.double()
    names = ["CTRL_C_jaw.ty", "CTRL_L_mouth_lipsTogetherU.ty", "CTRL_R_mouth_funnelU.ty"]
    slope = torch.autograd.functional.jacobian(exact, point)
    for name in names:
        step = torch.zeros_like(point)
        step[PLACE[name]] = 1e-5
        difference = (exact(point + step) - exact(point - step)) / 2e-5
        torch.testing.assert_close(slope[:, PLACE[name]], difference, atol=1e-5, rtol=1e-4)
    lips.float()


def test_fitted_curves_give_the_measured_lips_back(lips, rng):
    truth = REST.repeat(30, 1)
    for name, top in (("CTRL_C_jaw.ty", 0.5), ("upperLipRaise", 0.4), ("stretch.ty", 0.4)):
        swing = torch.from_numpy(rng.uniform(0, top, 30)).float()
        for i, control in enumerate(CONTROLS.names):
            if name in control:
                truth[:, i] = swing
    wanted = lips(truth) - lips(REST)
    wanted[7] = torch.nan
    prior = REST.repeat(30, 1)
    curves = fit_curves(prior, wanted, lips, CONTROLS)
    given = lips(curves) - lips(REST)
    known = torch.isfinite(wanted).all(dim=1)
    assert (given - wanted)[known].abs().max() < 0.08  # cm, of openings up to 1.6
    assert (given - wanted)[known].abs().mean() < 0.02
    torch.testing.assert_close(curves[7], prior[7])
    moved = (curves - prior).abs().amax(dim=0) > 0
    assert not moved[looseness(CONTROLS) == 0].any()
    assert (curves >= torch.tensor(CONTROLS.minimum)).all()
    assert (curves <= torch.tensor(CONTROLS.maximum)).all()
    for name in CONTROLS.names:  # the measures do not tell the sides apart
        if name.startswith("CTRL_L_mouth"):
            left, right = PLACE[name], PLACE[name.replace("CTRL_L", "CTRL_R")]
            torch.testing.assert_close(curves[:, left], curves[:, right], atol=2e-3, rtol=0)


def test_prediction_that_fits_stays(lips):
    prior = posed(**{"C_jaw.ty": 0.4, "funnel": 0.3}).repeat(5, 1)
    curves = fit_curves(prior, lips(prior) - lips(REST), lips, CONTROLS)
    torch.testing.assert_close(curves, prior, atol=1e-4, rtol=0)


def test_every_loose_part_names_a_control():
    for part in LOOSENESS:
        assert any(part in name for name in CONTROLS.names), part


def write_measured(folder, openings, *, rate=16000, seconds=2.0):
    """Speakers whose lower lip and jaw go down with a given opening (distances of the eyes)."""
    (folder / "video").mkdir(parents=True)
    (folder / "columns.json").write_text(json.dumps({"columns": ["x", *COLUMNS]}))
    rows = ["clip,speaker,words"]
    noise = np.random.default_rng(0).normal(0, 0.1, int(seconds * rate))
    for name, (speaker, opening) in openings.items():
        table = np.zeros((int(seconds * 25), 7))
        table[:, 1] = opening
        table[:, 2:] = (0.8, 0.55, 0.8, 0.85, 0.82)
        table[:, 2] += 0.6 * opening
        table[:, 5] += opening
        np.savez(folder / "video" / f"{name}.npz", meas=np.round(table * 1e4).astype(np.int16))
        sf.write(folder / "video" / f"{name}.wav", noise, rate)
        rows.append(f"{name},{speaker},one:0.50-0.90 two:0.90-1.50")
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")
    return folder


def three_clips(place):
    wave = 0.05 * (1 - np.cos(np.arange(50) / 25 * 2 * np.pi))  # closed at 0, 1 and 2 s
    return write_measured(
        place / "lips", {"a": ("one", wave), "b": ("one", wave), "c": ("two", wave + 0.01)}
    )


@pytest.fixture
def measured(tmp_path):
    return three_clips(tmp_path)


def test_measures_are_displacements_from_rest_at_30_frames(measured):
    clips = {clip.name: clip for clip in read_lips(measured, 9.0)}
    assert [clips[n].speaker for n in "abc"] == ["one", "one", "two"]
    for clip in clips.values():
        assert clip.measures.shape == (60, 6)
        times = np.arange(60) / 30
        assert (clip.speaking == ((times >= 0.5) & (times <= 1.5))).all()
        expected = 9 * 0.05 * (1 - np.cos((times * 25 - 0.5) / 25 * 2 * np.pi))
        inside = slice(2, 58)
        lowest = np.percentile(9 * 0.05 * (1 - np.cos(np.arange(50) / 25 * 2 * np.pi)), 5)
        np.testing.assert_allclose(
            clip.measures[inside, 0], expected[inside] - lowest, atol=0.015
        )  # the speaker's own zero is taken off, and time is right to a few milliseconds
        np.testing.assert_allclose(clip.measures[inside, 2:4], 0, atol=1e-5)
        np.testing.assert_allclose(clip.measures[inside, 5], 0, atol=1e-5)
        down = np.diff(clip.measures[inside], axis=0)
        np.testing.assert_allclose(down[:, 4], down[:, 0], atol=0.002)
        np.testing.assert_allclose(down[:, 1], 0.6 * down[:, 0], atol=0.002)


def test_missing_measures_are_nan(measured):
    path = measured / "video" / "a.npz"
    table = np.load(path)["meas"]
    table[20, 3] = -32768
    np.savez(path, meas=table)
    clip = read_lips(measured, 9.0)[0]
    known = np.isfinite(clip.measures)
    assert not known[round(20.5 / 25 * 30), 2] and known[:, 0].mean() > 0.95


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / "clips.csv").unlink(), "clips.csv"),
        (lambda f: (f / "clips.csv").write_text("name\nx\n"), "needs the columns clip and speaker"),
        (lambda f: (f / "clips.csv").write_text("clip,speaker,words\na,b,one\n"), "words as"),
        (lambda f: (f / "columns.json").write_text('{"columns": ["jaw"]}'), "lacks the measures"),
        (lambda f: (f / "columns.json").write_text("[]"), "list of names under columns"),
        (lambda f: (f / "video" / "a.npz").unlink(), "'a'.npz"),
        (lambda f: (f / "video" / "a.npz").write_bytes(b"PK"), "a.npz"),
        (lambda f: np.savez(f / "video" / "a.npz", meas=np.zeros((5, 7))), "int16"),
        (lambda f: np.savez(f / "video" / "a.npz", meas=np.zeros((5, 2), np.int16)), "2 columns"),
        (lambda f: (f / "video" / "a.wav").unlink(), "no sound of 'a'"),
        (lambda f: np.savez(f / "video" / "c.npz", meas=np.full((9, 7), -32768, np.int16)), "'two'"),
        (lambda f: (f / "clips.csv").write_text("clip,speaker,words\n"), "holds no clip"),
        (lambda f: (f / "clips.csv").write_text("clip,speaker,words\n,b,\n"), "words as"),
        (lambda f: os.truncate(f / "clips.csv", limits.TRACK_BYTES + 1), "at most 32 MiB"),
    ],
)  # fmt: skip
def test_read_lips_rejects_damaged_folders(tmp_path, damage, words):
    measured = three_clips(tmp_path)
    damage(measured)
    with one_line(DataError, words):
        read_lips(measured, 9.0)


def test_lip_dataset_holds_curves_that_repeat_the_lips(measured, tmp_path, lips):
    out = tmp_path / "data"
    model = require_model("default", DEITalk)
    assert write_lip_dataset(measured, out, model, validation=["two"], most=1) == 2
    clips = {clip.name: clip for clip in read_clips(out)}
    assert {n: (c.speaker, c.split, c.emotion) for n, c in clips.items()} == {
        "a": ("lips:one", "train", "neutral"),
        "c": ("lips:two", "validation", "neutral"),
    }
    assert not [
        c for c in inspect_dataset(out).checks if c.level == "error" and c.name != "emotions"
    ]
    wanted = next(c for c in read_lips(measured, lips.eye_distance) if c.name == "a")
    curves = torch.tensor(read_curves(clips["a"].curves).values)
    given = (lips(curves) - lips(REST))[:, 0].numpy()
    known = np.isfinite(wanted.measures[:, 0])
    assert np.abs(given - wanted.measures[:, 0])[known].max() < 0.15  # cm
    with pytest.raises(ExistsError):
        write_lip_dataset(measured, out, model)
    with pytest.raises(DataError, match="no speaker 'x'"):
        write_lip_dataset(measured, tmp_path / "new", model, test=["x"])
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["../../x", "a/b", "a\\b", "..", "C:x"])
def test_lip_dataset_rejects_clip_names_that_leave_the_folder(tmp_path, name):
    corpus = write_dataset(tmp_path / "corpus", 2, 2, 1.1)
    lips = write_measured(tmp_path / "lips", {"a": ("one", np.linspace(0, 0.1, 50))})
    table = pd.read_csv(corpus / "clips.csv", dtype=str, keep_default_na=False)
    table.loc[table.index[0], "clip"] = name
    table.to_csv(corpus / "clips.csv", index=False)
    out = tmp_path / "deep" / "er" / "data"
    out.parent.mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DataError, match="is no file name"):
        write_lip_dataset(lips, out, None, corpora=[corpus], corpus_clips=100)
    assert sorted(tmp_path.rglob("*")) == before


def test_lip_dataset_rejects_a_name_used_twice(tmp_path):
    corpus = write_dataset(tmp_path / "corpus", 2, 2, 1.1)
    name = read_clips(corpus, "train")[0].name
    lips = write_measured(tmp_path / "lips", {name: ("one", np.linspace(0, 0.1, 50))})
    with pytest.raises(DataError, match="appears 2 times"):
        write_lip_dataset(lips, tmp_path / "data", None, corpora=[corpus], corpus_clips=100)


def test_lip_dataset_rejects_a_corpus_without_training_speakers(measured, tmp_path):
    corpus = write_dataset(tmp_path / "corpus", 2, 2, 1.1)
    with pytest.raises(DataError, match="no speaker is left to train on"):
        write_lip_dataset(
            measured, tmp_path / "data", None, validation=["one"], test=["two"], corpora=[corpus]
        )
    assert not (tmp_path / "data").exists()


def test_ridge_finds_a_linear_law_of_features_in_context(rng):
    weights = rng.normal(size=(6, 3))
    recordings = []
    for who, n in (("one", 30), ("two", 2), ("three", 2)):
        for _ in range(n):
            features = rng.normal(size=(80, 3)).astype(np.float32)
            features = np.cumsum(features, axis=0) * 0.2
            measures = (np.roll(features, -2, axis=0) @ weights.T + 0.3).astype(np.float32)
            measures[-2:] = np.nan  # rolled over the end
            recordings.append((who, features, measures))
    ridge = LipRidge.fit(recordings, ridge=0.01)
    _, features, measures = recordings[-1]
    np.testing.assert_allclose(ridge(features)[:-4], measures[:-4], atol=0.02)


def test_speakers_count_alike_in_the_ridge(rng):
    """200 recordings of one speaker do not outvote three of another."""
    recordings = [
        (who, np.ones((20, 2), np.float32) * (1 if k % 2 else -1), np.full((20, 6), value))
        for who, value, n in (("many", 0.0, 200), ("few", 1.0, 40))
        for k in range(n)
    ]
    ridge = LipRidge.fit([(w, f, m.astype(np.float32)) for w, f, m in recordings])
    assert ridge(np.zeros((3, 2), np.float32)) == pytest.approx(np.full((3, 6), 0.5), abs=1e-6)


def test_ridge_rejects_recordings_without_a_known_frame():
    missing = np.full((20, 6), np.nan, np.float32)
    with pytest.raises(DataError, match="no frame of the training speakers"):
        LipRidge.fit([("one", np.zeros((20, 2), np.float32), missing)])


def test_transfer_brings_lips_to_the_measured_amplitude(rng):
    own = rng.normal(size=(400, 6)).astype(np.float32)
    real = 2 * own + 0.1
    features = own @ rng.normal(size=(6, 5)).astype(np.float32)
    transfer = LipTransfer.fit([("a", features, own, real)])
    np.testing.assert_allclose(transfer.gain, 2, rtol=1e-3)
    np.testing.assert_allclose(transfer.offset, 0.1, atol=1e-3)


def test_corrected_clips_keep_contacts_and_all_but_the_lips(measured, tmp_path):
    corpus = write_dataset(tmp_path / "corpus", 2, 2, 1.1)
    out, model = tmp_path / "data", require_model("default", DEITalk)
    count = write_lip_dataset(measured, out, model, corpora=[corpus], corpus_clips=3)
    clips = read_clips(out)
    assert len(clips) == count == 3 + len([c for c in clips if c.source != "measured"])
    originals = {clip.name: clip for clip in read_clips(corpus)}
    loose = looseness(CONTROLS, [CONTACT]).numpy() > 0
    for clip in clips:
        if clip.source == "measured":
            continue
        old, new = (load_clip(c, CONTROLS) for c in (originals[clip.name], clip))
        n = min(len(old.values), len(new.values))
        old_values = cut(old, 0, n)[1].astype(np.float32)
        new_values = new.values[:n].astype(np.float32)
        np.testing.assert_allclose(new_values[:, ~loose], old_values[:, ~loose], atol=2e-3)
        assert (clip.emotion, clip.speaker, clip.split) == (
            originals[clip.name].emotion,
            originals[clip.name].speaker,
            originals[clip.name].split,
        )


def test_scores_of_the_measured_lips_themselves_are_perfect(measured, monkeypatch, lips):
    """A prediction that moves the head as was measured has r and ratios of 1."""
    from deitalk.research.evaluation import lips as scoring

    clips = {clip.sound: clip for clip in read_lips(measured, lips.eye_distance)}
    monkeypatch.setattr(
        scoring,
        "_predictions",
        lambda model, lips, clip: {
            "network": clips[clip.sound].measures * 1.0,
            "animated": clips[clip.sound].measures * 0.5,
            "loudness": -clips[clip.sound].measures,
        },
    )
    shutil.copy(measured / "video" / "a.wav", measured / "video" / "b.wav")
    monkeypatch.setattr(scoring, "listen", lambda model, encoder: lambda recording: {})
    report = evaluate(None, measured)
    assert set(report) == {"network", "animated", "loudness"}
    assert set(report["network"]) == {"one", "two", "mean"}
    for speaker in report["network"]:
        assert np.isnan(report["network"][speaker]["width r"])  # does not move
        assert report["network"][speaker]["opening r"] == pytest.approx(1)
        assert report["network"][speaker]["opening range"] == pytest.approx(1)
        assert report["animated"][speaker]["opening range"] == pytest.approx(0.5)
        assert report["animated"][speaker]["opening speed"] == pytest.approx(0.5)
        assert report["animated"][speaker]["opening jerk"] == pytest.approx(1)
        assert report["loudness"][speaker]["opening r"] == pytest.approx(-1)
    assert report["network"]["mean"]["clips"] == 3
    assert "opening r" in as_markdown(report)
    with pytest.raises(DataError, match="no speaker 'x'"):
        evaluate(None, measured, speakers=["x"])


def test_jerk_is_that_of_the_measured_lips_at_any_range():
    """A wave of n frames has a third derivative of (2 sin(pi / n))^2 times its first."""
    from deitalk.research.evaluation.lips import _scores

    t = np.arange(240)[:, None]
    quick, slow = (np.sin(2 * np.pi * t / n) * np.ones(6) for n in (4, 12))
    expected = (np.sin(np.pi / 4) / np.sin(np.pi / 12)) ** 2
    scores = _scores([(0.3 * quick, slow)], ranges=True)
    assert scores["jaw jerk"] == pytest.approx(expected, rel=0.02)


def test_model_follows_real_lips_better_than_loudness_does(shared):
    folder = shared / "data" / "lips"
    if not folder.is_dir():
        pytest.skip("needs the measured lips in ../shared")
    report = evaluate(require_model("default", DEITalk), folder, speakers=["s30"], most=5)
    for measure in ("opening", "jaw", "lower_lip"):
        ours, level = (report[n]["mean"][f"{measure} r"] for n in ("network", "loudness"))
        assert ours > level + 0.1 and ours > 0.4
