"""A study from takes to report: blind clips, simulated raters, exclusions, the page in a browser."""

import json
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk.errors import DataError
from deitalk.research.study.answers import read_answers, read_key
from deitalk.research.study.build import PLACE, build_study
from deitalk.research.study.clips import loudness_clip, read_clip, still_clip
from deitalk.research.study.report import as_markdown, report_study
from rig import RigCurves, default_controls, write_curves
from rig.errors import TargetError
from tests.browser import chromium

CONTROLS = default_controls()
JAW = CONTROLS.index("CTRL_C_jaw.ty")


def take(folder: Path, jaw: float, frames: int = 4) -> Path:
    """A take folder of a few frames, loud in its second half."""
    folder.mkdir(parents=True)
    values = np.tile(CONTROLS.rest, (frames, 1)).astype(np.float32)
    values[:, JAW] = np.linspace(0, jaw, frames)
    write_curves(folder / "curves.json", RigCurves(values, CONTROLS.names, fps=30))
    n = frames * 16_000 // 30
    tone = 0.3 * np.sin(np.arange(n) * 0.2)
    tone[: n // 2] *= 0.001
    soundfile.write(folder / "audio.wav", tone, 16_000)
    return folder


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A study of two systems on two recordings, and its key."""
    pytest.importorskip("av", reason="videos need PyAV")
    root = tmp_path_factory.mktemp("study")
    for name, jaw in (("ours", 0.5), ("theirs", 0.1)):
        for item in ("hello", "bye"):
            take(root / name / item, jaw)
    key = build_study(
        [root / "ours", root / "theirs"], root / "out", tasks=["realism", "lips"], raters=40, seed=3
    )
    return root / "out", key


def pages(study: Path) -> list:
    text = (study / "index.html").read_text()
    data = text.split('id="study">')[1].split("</script>")[0]
    return json.loads(data)["raters"]


def answer(key, rows, rng, preference, *, rater, seconds=4.0, honest=True):
    """Answers of a rater who prefers the first system with some probability."""
    out = []
    for row in rows:
        systems = [key["clips"][name]["system"] for name in row["clips"]]
        if None in systems:
            moves = systems.index(None) ^ 1
            choice = moves if honest else systems.index(None)
        else:
            first = systems.index(key["systems"][0])
            choice = first if rng.random() < preference else first ^ 1
        out.append(row | {"choice": row["clips"][choice], "seconds": seconds, "plays": 1})
    return {"schema": "deitalk.answers/1", "study": key["study"], "id": rater, "code": "",
            "rater": 0, "answers": out}  # fmt: skip


def test_published_files_do_not_name_the_systems(built):
    out, key = built
    page = (out / "index.html").read_text()
    assert "ours" not in page.split('id="study">')[1] and "theirs" not in page and PLACE not in page
    clips = sorted(path.stem for path in (out / "clips").iterdir())
    assert clips == sorted(key["clips"]) and len(clips) == 2 * 2 + 2
    assert json.loads((out / "key.json").read_text()) == key
    assert "http" not in page.replace("https", "http").split("<style>")[0]


def test_bias_of_simulated_raters_is_recovered_and_careless_ones_are_left_out(built, tmp_path):
    out, key = built
    rng = np.random.default_rng(1)
    for k, rows in enumerate(pages(out)):
        told = answer(key, rows, rng, 0.8, rater=str(k))
        if k == 0:
            told = answer(key, rows, rng, 0.0, rater="0", honest=False)
        elif k == 1:
            told = answer(key, rows, rng, 0.0, rater="1", seconds=0.3)
        elif k == 2:
            told["id"] = "3"
        (tmp_path / f"{k:02d}.json").write_text(json.dumps(told))
    answers = read_answers(tmp_path, read_key(out / "key.json"))
    assert answers.raters == 37
    assert answers.excluded["00.json"] == "3 checks failed"
    assert answers.excluded["01.json"] == "median of 0.3 s a trial"
    assert answers.excluded["03.json"] == "second file of one rater"
    report = report_study(key, answers)
    for task in ("realism", "lips"):
        scores = report["tasks"][task]
        pair = scores["pairs"]["ours over theirs"]
        assert pair["n"] == 37 * 2 and pair["low"] < 0.8 < pair["high"] and pair["p"] < 1e-3
        assert scores["strengths"]["ours"]["low"] > 0
        assert scores["left"]["low"] < 0.5 < scores["left"]["high"]
    assert "| ours over theirs |" in as_markdown(report) or "ours over theirs" in as_markdown(
        report
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "other"}, "holds no answers"),
        ({"study": "other"}, "of another study"),
        ({"answers": [{"kind": "trial"}]}, "not as the page writes them"),
        ({"answers": "x"}, "not as the page writes them"),
        ({"answers": []}, None),
    ],
)
def test_answers_that_the_page_did_not_write_are_refused(built, tmp_path, change, message):
    out, key = built
    told = answer(key, pages(out)[0], np.random.default_rng(0), 0.5, rater="a") | change
    (tmp_path / "a.json").write_text(json.dumps(told))
    if message is None:
        assert read_answers(tmp_path, key).excluded == {"a.json": "no trial answered"}
        return
    with pytest.raises(DataError, match=message):
        read_answers(tmp_path, key)


def test_folder_without_answers_and_a_key_of_something_else_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"has no \.json of answers"):
        read_answers(tmp_path, {})
    (tmp_path / "key.json").write_text("{}")
    with pytest.raises(DataError, match="is no key of a study"):
        read_key(tmp_path / "key.json")


def test_systems_must_share_items_of_one_length(tmp_path):
    take(tmp_path / "a/x", 0.5)
    take(tmp_path / "b/y", 0.5)
    with pytest.raises(DataError, match="no item in common"):
        build_study([tmp_path / "a", tmp_path / "b"], tmp_path / "out")
    take(tmp_path / "b/x", 0.5, frames=30)
    with pytest.raises(DataError, match="must have one length"):
        build_study([tmp_path / "a", tmp_path / "b"], tmp_path / "out")
    (tmp_path / "c").mkdir()
    with pytest.raises(DataError, match="has no takes"):
        build_study([tmp_path / "a", tmp_path / "c"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_of_the_user_is_not_replaced(built, tmp_path):
    out, _ = built
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    systems = [out.parent / "ours", out.parent / "theirs"]
    with pytest.raises(TargetError):
        build_study(systems, tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_still_and_loudness_clips(tmp_path):
    """The still face never moves; the jaw of loudness is 0 in silence and the take's in sound."""
    clip = read_clip(take(tmp_path / "x", 0.5, frames=60), None)
    still = still_clip(clip).source.curves.values
    assert np.ptp(still, axis=0).max() == 0
    moved = loudness_clip(clip).source.curves.values
    assert moved[:20, JAW].max() < 0.05
    assert moved[40:, JAW] == pytest.approx(np.percentile(np.linspace(0, 0.5, 60), 95), abs=0.02)
    assert np.delete(moved, JAW, axis=1).max() == 0
    assert read_clip(Path("a.mp4"), None).source is None


def test_curves_take_the_recording_of_the_take_of_their_name(tmp_path):
    folder = take(tmp_path / "a/x", 0.5)
    (tmp_path / "b").mkdir()
    shutil.copy(folder / "curves.json", tmp_path / "b/x.json")
    clip = read_clip(tmp_path / "b/x.json", folder / "audio.wav")
    assert clip.source.sample_rate == 16_000
    with pytest.raises(DataError, match="has no recording"):
        read_clip(tmp_path / "b/x.json", None)


def reload_with_answers(tab, patience_seconds: float = 120) -> None:
    """Reload until the kept answers are there: a reload at once may overtake the browser's storage."""
    end = time.monotonic() + patience_seconds
    tab.reload()
    while tab.locator("#intro").is_visible() and time.monotonic() < end:
        tab.reload()


def test_page_asks_for_every_trial_and_saves_the_answers(built, tmp_path):
    """Only after all clips have ended; the answers are those that the report reads."""
    out, key = built
    with chromium() as browser, browser.new_context(offline=True, accept_downloads=True) as window:
        tab = window.new_page()
        errors: list[str] = []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto((out / "index.html").as_uri() + "?rater=7")
        tab.click("#start")
        n = len(pages(out)[6])
        for k in range(n):
            if k == 2:
                reload_with_answers(tab)
            assert tab.locator("figure button").first.is_disabled()
            tab.keyboard.press("1")  # too early: ignored
            tab.keyboard.press(" ")
            tab.wait_for_function("!document.querySelector('figure button').disabled")
            tab.keyboard.press("1")
        tab.wait_for_selector("#end:not([hidden])")
        with tab.expect_download() as saved:
            tab.click("#save")
        saved.value.save_as(tmp_path / "seven.json")
    assert not errors
    told = json.loads((tmp_path / "seven.json").read_text())
    assert told["rater"] == 6 and len(told["answers"]) == n
    assert [row["clips"] for row in told["answers"]] == [row["clips"] for row in pages(out)[6]]
    assert all(row["choice"] == row["clips"][0] for row in told["answers"])
    answers = read_answers(tmp_path, key, failed_checks=3)
    assert answers.raters == 1 or "s a trial" in answers.excluded["seven.json"]
