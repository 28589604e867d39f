"""Takes that follow one another: no step at the join, nothing else changed."""

import json
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch

from deitalk import animate
from deitalk.acting import Acting
from deitalk.audio.load import load_audio
from deitalk.errors import DataError
from deitalk.models.curve_model import DEITalk
from deitalk.postprocess.edges import (
    LONGEST_QUIET,
    TAKE_CURVES,
    TAKE_SOUND,
    Edge,
    edge_of,
    opened_take,
)
from deitalk.postprocess.joins import HEAD_FRAMES, lead
from rig import RigCurves, default_controls
from rig.errors import UserError
from tests.deitalk.pipeline.test_curves import SMALL, recording
from tests.errors import one_line

pytestmark = pytest.mark.usefixtures("one_analysis")
CONTROLS = default_controls()
MOST_TURN = 1.0
"""Degrees in a frame."""


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return DEITalk(SMALL).eval()


@pytest.fixture(scope="module")
def first(network):
    return animate(recording(1.5), "happy", model=network)


def steps(rows):
    return np.abs(np.diff(rows, axis=0))


def check_join(before, after):
    """No control steps further at the join than within a take, and the head turns slowly."""
    step = np.abs(after.curves.values[0] - before.curves.values[-1])
    inside = max(steps(part.curves.values).max() for part in (before, after))
    assert step.max() <= inside
    heads = [part.head[:, :3] for part in (before, after)]
    both = np.concatenate((heads[0][-HEAD_FRAMES:], heads[1][:HEAD_FRAMES]))
    assert steps(both).max() <= max(MOST_TURN, *(steps(head).max() for head in heads))


CUTS = (0.9, 1.42, 1.9, 2.6)
"""Seconds at which a sentence is cut: in words, and in its pauses."""


@pytest.mark.parametrize("seconds", CUTS)
@pytest.mark.parametrize("emotions", [("happy", "happy"), ("angry", "sad"), ("neutral", "disgust")])
def test_a_sentence_that_is_cut_has_no_step(default, seconds, emotions):
    whole = load_audio("docs/samples/promise.flac")
    at = round(seconds * 16_000)
    parts = [whole.waveform[:at], whole.waveform[at:]]
    before = animate(parts[0], emotions[0], model=default, sample_rate=16_000)
    check_join(
        before, animate(parts[1], emotions[1], model=default, sample_rate=16_000, after=before)
    )


def test_the_known_case_has_no_step(default, shared):
    folder = shared / "cases" / "17_joins"
    before = animate(folder / "a.wav", "happy", model=default)
    place = before.curves.index("CTRL_L_mouth_cornerPull.ty")
    after = animate(folder / "b.wav", "happy", model=default, after=before)
    check_join(before, after)
    assert abs(after.curves.values[0, place] - before.curves.values[-1, place]) < 0.05


@pytest.mark.parametrize("emotion", ["happy", "sad", "angry"])
def test_an_end_leads_into_the_take_after_it(default, emotion):
    whole = load_audio("docs/samples/promise.flac").waveform
    after = animate(whole, "surprised", model=default, sample_rate=16_000)
    before = animate(whole, emotion, model=default, sample_rate=16_000, into=after)
    check_join(before, after)


def test_scene_of_lines_is_one_character(network, first):
    second = animate(recording(1.2), model=network, after=first)
    third = animate(recording(0.9), model=network, after=second)
    for line in (second, third):
        assert line.traits == pytest.approx(first.traits, abs=1e-5)
    assert animate(recording(0.9), model=network).traits != first.traits


def test_only_the_beginning_changes(network, first):
    """The own motion is there from the head's passage on; the last frame is never another.

    Without the traits of the other take: the sides of an expression are those of the character.
    """
    edge = replace(edge_of(first, "after", last=True), traits={})
    alone = animate(recording(4.0), "happy", model=network, life="off")
    joined = animate(recording(4.0), "happy", model=network, life="off", after=edge)
    later = slice(HEAD_FRAMES, None)
    assert np.array_equal(joined.curves.values[later], alone.curves.values[later])
    assert not np.array_equal(joined.curves.values[0], alone.curves.values[0])


def random_edge(rng, head=True):
    pose = rng.uniform(CONTROLS.minimum, CONTROLS.maximum)
    speed = 0.05 * rng.standard_normal(len(pose))
    turn = tuple(4 * rng.standard_normal(6)) if head else ()
    return Edge(
        dict(zip(CONTROLS.names, pose, strict=True)),
        dict(zip(CONTROLS.names, speed, strict=True)),
        turn,
        tuple(0.1 * rng.standard_normal(len(turn))),
    )


def led(edge, length, rng, **options):
    values = np.tile(rng.uniform(0, 0.3, len(CONTROLS)).astype(np.float32), (length, 1))
    head = np.zeros((length, 6), np.float32)
    own = values.copy(), head.copy()
    lead(values, head, CONTROLS, edge, **options)
    return values, head, *own


@pytest.mark.parametrize("length", [1, 2, 5, 40, 200])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("number", range(4))
def test_passage_is_within_the_ranges_and_leaves_the_other_end(length, last, number):
    rng = np.random.default_rng(number)
    values, head, own, still = led(random_edge(rng), length, rng, last=last)
    assert (values >= CONTROLS.minimum - 1e-6).all() and (values <= CONTROLS.maximum + 1e-6).all()
    other = 0 if last else -1
    assert np.array_equal(values[other], own[other]) and np.array_equal(head[other], still[other])
    if length > 90:
        assert steps(head[:, :3]).max() <= MOST_TURN


@pytest.mark.parametrize("last", [False, True])
def test_first_frame_goes_on_at_the_speed_of_the_edge(rng, last):
    edge = random_edge(rng)
    values, head, *_ = led(edge, 300, rng, last=last)
    pose = np.array([edge.pose[name] for name in CONTROLS.names])
    beside = values[-1 if last else 0]
    speed = np.abs([edge.speed[name] for name in CONTROLS.names])
    assert (np.abs(beside - pose) <= speed + 0.1).all()
    turn = np.abs(head[-1 if last else 0, :3] - np.array(edge.head[:3]))
    assert (turn <= np.abs(edge.head_speed[:3]) + 0.05).all()


def test_lips_that_meet_in_the_passage_meet(rng):
    together = [k for k, name in enumerate(CONTROLS.names) if "lipsTogether" in name]
    values = np.zeros((30, len(CONTROLS)), np.float32)
    values[3:6, together] = 1
    edge = Edge({"CTRL_C_jaw.ty": 0.8})
    lead(values, None, CONTROLS, edge)
    assert values[3:6, together].min() == 1
    assert values[4, CONTROLS.index("CTRL_C_jaw.ty")] < 0.05


def test_every_form_of_a_take_has_one_edge(first, tmp_path):
    folder = first.save(tmp_path / "take")
    shutil.make_archive(str(tmp_path / "take"), "zip", folder)
    shutil.make_archive(str(tmp_path / "in_folder"), "zip", tmp_path, "take")
    wanted = edge_of(first, "after", last=True)
    archive, content = tmp_path / "take.zip", tmp_path / "edge.json"
    content.write_text(str(wanted))
    forms = (archive, tmp_path / "in_folder.zip", content, str(wanted), wanted.content, wanted)
    for given in (str(folder), folder, *forms):
        found = edge_of(given, "after", last=True)
        assert found.traits == pytest.approx(wanted.traits, abs=1e-5)
        assert found.quiet == pytest.approx(wanted.quiet, abs=1e-3)
        assert found.pose == pytest.approx(wanted.pose, abs=2e-5)
        names = {*found.speed, *wanted.speed}  # a speed of 0 is left out
        speeds = [[edge.speed.get(name, 0.0) for name in names] for edge in (found, wanted)]
        assert speeds[0] == pytest.approx(speeds[1], abs=4e-5)
        assert found.head == pytest.approx(wanted.head, abs=1e-4)
    for name in ("curves.csv", "curves.json"):
        assert edge_of(folder / name, "after", last=True).pose == pytest.approx(
            wanted.pose, abs=2e-5
        )


@pytest.mark.parametrize("fps", [24, 60])
def test_speeds_are_those_of_a_thirtieth_of_a_second(fps):
    values = np.arange(60, dtype=np.float32)[:, None] * 0.3 / fps
    curves = RigCurves(values, ("CTRL_C_jaw.ty",), fps=fps)
    for last, sign in ((True, 1), (False, 1)):
        edge = Edge.of_curves(curves, last=last)
        assert edge.speed["CTRL_C_jaw.ty"] == pytest.approx(sign * 0.01, abs=1e-4)


def test_settings_hold_the_edge_and_give_the_take_again(network, first, tmp_path):
    folder = first.save(tmp_path / "take")
    made = animate(recording(1.2), model=network, after=folder, into=folder)
    settings = json.loads(json.dumps(made.acting.settings))
    assert settings.keys() == {"after", "into"}
    shutil.rmtree(folder)
    again = animate(recording(1.2), model=network, acting=Acting.of(files={}, **settings))
    assert np.array_equal(again.curves.values, made.curves.values)


@pytest.mark.parametrize("field", ["after", "into"])
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("nowhere", "no take nowhere"),
        (3, "a take folder"),
        ('{"format": "x"}', "no edge"),
        ({"format": "deitalk-edge", "version": 2}, "version"),
        ({"format": "deitalk-edge", "version": 1, "pose": {"a": "b"}}, "finite number"),
        ({"format": "deitalk-edge", "version": 1, "pose": {"a": 1e9}}, "finite number"),
        ({"format": "deitalk-edge", "version": 1, "head": [1, 2]}, "6 numbers"),
        ({"format": "deitalk-edge", "version": 1, "head": [0] * 6}, "head_speed"),
        ({"format": "deitalk-edge", "version": 1, "quiet": -1}, "quiet"),
        ({"format": "deitalk-edge", "version": 1, "traits": {"nose": 1}}, "traits"),
        ({"format": "deitalk-edge", "version": 1, "traits": {"side": 9}}, "side"),
    ],
)
def test_what_is_no_take_is_refused_in_one_line(field, given, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with one_line(UserError, match=words):
        Acting.of(**{field: given})


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x00" * 100])
def test_damaged_archive_is_refused_in_one_line(content, tmp_path):
    path = tmp_path / "take.zip"
    path.write_bytes(content)
    with one_line(DataError, match="take"):
        edge_of(path, "after", last=True)


@pytest.mark.parametrize(
    ("entries", "read"),
    [
        (("curves.json", "audio.wav"), {"curves.json": "curves.json", "audio.wav": "audio.wav"}),
        (("a/b/curves.json", "a/b/old/curves.json", "a/audio.wav", "__MACOSX/a/b/._curves.json"),
         {"curves.json": "a/b/curves.json"}),
        (("curves.json", "old/curves.json", "old/audio.wav"), {"curves.json": "curves.json"}),
        (("audio.wav",), {}),
        (("a/curves.json", "b/curves.json"), "2 takes: a, b;"),
        (("a/curves.json", "../curves.json", "/curves.json"), "takes"),
    ],
)  # fmt: skip
def test_take_in_an_archive_lies_in_its_outermost_folder(entries, read, tmp_path):
    """Each file's content is its own name."""
    path = tmp_path / "take.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for entry in entries:
            archive.writestr(entry, entry)
    if isinstance(read, str):
        with one_line(DataError, match=read), opened_take(path, (TAKE_CURVES, TAKE_SOUND)):
            pass
        return
    with opened_take(path, (TAKE_CURVES, TAKE_SOUND)) as folder:
        assert {file.name: file.read_text() for file in folder.iterdir()} == read


def test_empty_folder_is_no_take(tmp_path):
    with one_line(DataError, match="curves.json"):
        edge_of(tmp_path, "after", last=True)


def test_silence_counts_up_to_a_limit(network):
    silent = animate(np.zeros(20 * 16_000, np.float32), model=network, sample_rate=16_000)
    assert edge_of(silent, "after", last=True).quiet == LONGEST_QUIET
