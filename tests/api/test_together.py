"""Recordings of several requests read in one pass: as each alone, and no one's trouble another's."""

import io
import json
import queue
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from multiprocessing.connection import wait

import httpx
import numpy as np
import pytest

from api.compute import reader
from api.compute.reader import Line, Reader, Request, new_address
from api.compute.shared import SharedNetwork, packed, unpacked
from deitalk import animate
from deitalk.audio.frames import frame_count
from deitalk.models.load import load_network
from deitalk.models.protocol import Reading, Tracks
from rig import read_curves
from tests.api.conftest import wav
from tests.api.kill import kill
from tests.api.server import serving
from tests.api.test_worker import limits

SOUND = np.zeros(533, np.float32)


class Sent:
    """A worker's connection that keeps what it is sent."""

    def __init__(self):
        self.sent = []

    def send_bytes(self, content):
        self.sent.append(content)


def request(model="a", frames=1, is_open=True, sound=SOUND):
    line = Line(Sent())
    line.is_open = is_open
    return Request(line, model, "", sound, np.zeros((frames, 5), np.float32))


class Waiting(queue.SimpleQueue):
    """Requests that wait, after which none comes."""

    def __init__(self, *requests):
        for each in requests:
            self.put(each)

    def get(self):
        return self.get_nowait()


def test_pass_is_the_oldest_recording_and_the_next_of_its_model():
    a, b, c, d, e = (request(model) for model in "ababa")
    gone = request("a", is_open=False)
    line = Waiting(gone, a, b, c, gone, d, e)
    assert list(islice(reader.groups(line, 2), 3)) == [[a, c], [b, d], [e]]


def test_pass_has_a_bounded_number_of_frames():
    half = reader.PASS_FRAMES // 2
    long, other, short = request(frames=half + 1), request(frames=half), request(frames=9)
    assert list(islice(reader.groups(Waiting(long, other, short), 8), 2)) == [
        [long, short],
        [other],
    ]


class Network:
    """Reads the loudness of a sound as its curves, refuses silence, and no two at once with it."""

    def read(self, sound, weights, actor):
        assert sound.any()
        rows = np.full((len(weights), 3), sound.max(), np.float32)
        return Reading(rows, rows, Tracks(None, rows[:, 0] / 2, None))

    def read_together(self, *given):
        return [self.read(*each) for each in zip(*given, strict=True)]


def test_recording_that_cannot_be_read_fails_alone():
    loud, silent, soft = (request(sound=np.full(9, level, np.float32)) for level in (0.5, 0, 0.1))
    found = list(reader.answers([loud, silent, soft], lambda name: Network()))
    assert [each for each, _, _ in found] == [loud, silent, soft]
    assert found[0][1].neutral.max() == 0.5 and found[2][1].neutral.max() == np.float32(0.1)
    assert isinstance(found[1][1], AssertionError)
    together = list(reader.answers([loud, soft], lambda name: Network()))
    assert [count for _, _, count in together] == [2, 2]


@pytest.mark.parametrize("is_neutral", [True, False])
def test_reading_is_the_same_on_the_other_side(rng, is_neutral):
    neutral, emotional = rng.standard_normal((2, 7, 4)).astype(np.float32)
    strength = rng.random(7).astype(np.float32)
    sent = Reading(neutral, neutral if is_neutral else emotional, Tracks(None, strength, -strength))
    found = unpacked(*packed(sent), 7)
    assert (found.emotional is found.neutral) == is_neutral
    for mine, theirs in zip(found[:2], sent[:2], strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert mine.flags.writeable and mine.flags.c_contiguous  # rules work in place
    assert found.tracks.saliency is None
    np.testing.assert_array_equal(found.tracks.strength, strength)
    np.testing.assert_array_equal(found.tracks.effort, -strength)


def test_reader_that_ends_or_fails_is_replaced_and_meanwhile_a_worker_reads_by_itself():
    address = new_address()
    network = SharedNetwork(load_network("default"), "default", address)
    sound = (0.1 * np.sin(np.arange(16_000) / 20)).astype(np.float32)
    given = sound, np.eye(5, dtype=np.float32)[[2] * frame_count(len(sound))]
    expected = network.network.read(*given)
    made = Reader(limits(reader=address), 4)
    made.start()
    try:
        network.together = 0
        np.testing.assert_allclose(network.read(*given).emotional, expected.emotional, atol=1e-5)
        assert network.together == 1 and SharedNetwork._line is not None
        before = made.process.pid
        kill(before)
        wait([made.process.sentinel], 60)
        np.testing.assert_allclose(network.read(*given).emotional, expected.emotional, atol=1e-5)
        assert SharedNetwork._line is None
        end = time.monotonic() + 60
        while SharedNetwork._line is None:
            assert time.monotonic() < end
            network.read(*given)
        assert made.process.pid != before
        failing = SharedNetwork(network.network, "no such model", address)
        before = made.process.pid
        for _ in range(reader.MOST_FAILURES):
            assert made.process.pid == before
            np.testing.assert_allclose(failing.read(*given).neutral, expected.neutral, atol=1e-5)
        while made.process.pid == before:
            assert time.monotonic() < end
            time.sleep(0.1)
    finally:
        made.stop()
        SharedNetwork._line = None


# Over HTTP.


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(
        tmp_path_factory.mktemp("together"), workers=3, read_together=8, log="json",
        live_sessions=0, requests_per_minute=100_000,
    ) as running:  # fmt: skip
        yield running


def send(server, seconds=1.0, recording=None, timeout=120.0, name="", **fields):
    return httpx.post(
        f"{server.url}/v1/animations",
        params={"format": "npz", **fields}, content=wav(seconds) if recording is None else recording,
        headers={"Content-Type": "audio/wav", **({"X-Request-ID": name} if name else {})},
        timeout=timeout, trust_env=False,
    )  # fmt: skip


def counts(server):
    """Recordings that were read, and those of them that were read alone."""
    text = httpx.get(f"{server.url}/metrics", timeout=60, trust_env=False).text
    names = "count", r'bucket\{le="1.0"\}'
    return [
        float(re.search(rf"^deitalk_read_together_{name} (.*)$", text, re.M)[1]) for name in names
    ]


GIVEN = [
    {"seconds": 1.0, "emotion": "happy", "model": "default"},
    {"seconds": 2.3, "emotion": "angry=0.5", "model": "default"},
    {"seconds": 1.9, "emotion": "neutral", "model": "default"},
    {"seconds": 12.0, "emotion": "sad", "model": "default"},
    {"seconds": 1.0, "emotion": "surprised", "model": "mel"},
    {"seconds": 1.0, "emotion": "sad", "model": "mel"},
]


def test_results_are_those_of_each_alone(server, tmp_path):
    """Of different lengths, emotions and models at once; rules are steep, and so is rounding."""
    before = counts(server)
    asked = [given | {"rules": rules} for given in GIVEN for rules in (False, True)]
    with ThreadPoolExecutor(6) as threads:
        answers = list(threads.map(lambda given: send(server, **given), asked))
    for given, answer in zip(asked, answers, strict=True):
        assert answer.status_code == 200, answer.text
        (tmp_path / "curves.npz").write_bytes(answer.content)
        found = read_curves(tmp_path / "curves.npz").values
        sound, emotion, model, rules = (given[name] for name in GIVEN[0] | {"rules": None})
        network = load_network(model)
        expected = animate(wav(sound), emotion, model=network, rules=rules).curves.values
        ranges = network.controls.maximum - network.controls.minimum
        assert (abs(found - expected) / ranges).max() <= (1e-4 if rules else 1e-5)
    read, alone = (now - then for now, then in zip(counts(server), before, strict=True))
    assert read == len(answers) and alone < read


def test_what_ends_one_request_ends_no_other(server):
    """Noise that is no recording, and clients who leave; every answer is its own request's."""

    def frames(number):
        answer = send(server, 0.5 + number / 10, name=f"id-{number}")
        assert answer.status_code == 200 and answer.headers["x-request-id"] == f"id-{number}"
        return len(np.load(io.BytesIO(answer.content))["values"])

    with ThreadPoolExecutor(9) as threads:
        gone = [threads.submit(send, server, 50.0, timeout=0.4) for _ in range(3)]
        bad = [threads.submit(send, server, recording=b"RIFF" + bytes(99)) for _ in range(3)]
        good = [threads.submit(frames, number) for number in range(12)]
        assert [each.result() for each in good] == [15 + 3 * number for number in range(12)]
        assert {each.result().status_code for each in bad} == {422}
        for each in gone:
            with pytest.raises(httpx.TimeoutException):
                each.result()
    logged: dict[str, int] = {}
    end = time.monotonic() + 60  # a line is written after its answer was sent
    while len(logged) < 12 and time.monotonic() < end:
        lines = [line for line in server.log.read_text().splitlines() if '"id-' in line]
        logged = {entry["request"]: entry["status"] for entry in map(json.loads, lines)}
    assert logged == {f"id-{number}": 200 for number in range(12)}


def test_death_of_the_reader_loses_no_request(server):
    def last_reader():
        return int(re.findall(r"process (\d+) reads", server.log.read_text())[-1])

    before, over = last_reader(), threading.Event()

    def keep_asking(seconds):
        statuses = []
        while not over.is_set():
            statuses.append(send(server, seconds).status_code)
        return statuses

    with ThreadPoolExecutor(3) as threads:
        asking = [threads.submit(keep_asking, seconds) for seconds in (1.0, 2.0, 3.0)]
        time.sleep(1)
        kill(before)
        end = time.monotonic() + 60
        while last_reader() == before and time.monotonic() < end:
            time.sleep(0.1)
        over.set()
        assert {status for each in asking for status in each.result()} == {200}
    assert last_reader() != before
    assert "the process that reads for all requests ended" in server.log.read_text()
