"""Frames while somebody speaks: their order, their times, changes, and hostile clients."""

import asyncio
import json
import runpy
import shutil
import subprocess
import sys
import threading
import time
from base64 import b64encode
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import uvicorn
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from api.errors import Problem
from api.guard import protocol
from api.guard.keys import Places
from api.live import route as live_route
from api.live.messages import FRAME, Start, acting_of
from api.live.stream import LiveStream
from api.serving import server_config
from api.settings import Settings
from deitalk import Acting, LiveAnimator
from deitalk.errors import ConfigError
from tests.api.conftest import KEYS, bearer, wav
from tests.api.server import PATIENCE, free_port, wait_for
from tests.api.test_queue import CALLER
from tests.errors import one_line

RATE = 16000


def pcm(seconds: float, rate: int = RATE) -> bytes:
    return wav(seconds, rate)[44:]


def test_samples_that_are_not_finite_are_refused():
    stream = LiveStream(RATE, True, SimpleNamespace(feed=lambda chunk: None))
    with pytest.raises(Problem):
        stream.feed(np.array([0.0, np.nan], "<f4").tobytes())
    stream.feed(b"\0")  # a part of a sample waits for the rest
    stream.feed(b"\0\0\0")
    assert stream.end <= 1


def live(server, **given):
    return connect(
        server.url.replace("http", "ws") + "/v1/live", max_size=2**24, proxy=None, **given
    )


def begin(session, **given):
    session.send(json.dumps({"type": "start", **given}))
    return json.loads(session.recv(PATIENCE))


def records(message: bytes, n_values: int):
    size = FRAME.size + 4 * n_values
    assert len(message) % size == 0
    for start in range(0, len(message), size):
        index, late, at = FRAME.unpack_from(message, start)
        yield index, late, at, np.frombuffer(message, "<f4", n_values, start + FRAME.size)


@pytest.mark.parametrize(
    ("messages", "code"),
    [
        (["no json"], "message_unknown"),
        (['{"type": "start", "sample_rate": 1}'], "option_invalid"),
        (['{"type": "start", "emotion": "moods.csv"}'], "emotion_invalid"),
        (['{"type": "start", "words": "Bob"}'], "option_invalid"),
        (['{"type": "start", "voice": "/etc/passwd"}'], "emotion_invalid"),
        (['{"type": "start", "model": "../x"}'], "model_unknown"),
        (['{"type": "start", "model": "sdfa"}'], "model_unfit"),
        (['{"type": "start", "model": "default"}'], "model_unfit"),
        (['{"type": "start", "life": "nose=1"}'], "request_invalid"),
        (['{"type": "start", "look_at": "90,0"}'], "request_invalid"),
        (['{"type": "start"}', '{"type": "jump"}'], "message_unknown"),
        (['{"type": "start"}', "[" * 4000], "message_unknown"),
        (['{"type": "start"}', "x" * 5000], "too_large"),
        ([b"\0" * 100], "message_unknown"),
        (['{"type": "set"}'], "message_unknown"),
        (['{"type": "start"}', *['{"type": "set"}'] * 100], "too_many_requests"),
    ],
)
def test_wrong_messages_end_the_session_with_a_problem(server, messages, code):
    with live(server) as session:
        for message in messages:
            session.send(message)
        answer = {}
        while answer.get("type") != "problem":
            answer = json.loads(session.recv(PATIENCE))
        assert answer["code"] == code
        with pytest.raises(ConnectionClosed):
            session.recv(PATIENCE)


@pytest.mark.parametrize(
    ("before", "known"),
    [
        (None, {"emotion", "style", "seed", *Start.model_fields}),
        (Acting(), {"emotion", "intensity", "rest", "look_at", "gain", "rules"}),
    ],
)
def test_an_unknown_field_is_told_with_those_that_the_message_may_have(before, known):
    with one_line(ConfigError, match="no field 'emotino'; known are ") as caught:
        acting_of({"emotino": "sad"}, before)
    told = {*str(caught.value).rpartition(" are ")[2].split(", ")}
    assert told >= known and (before is None or told == known) and "words" not in told


def test_wrong_change_is_answered_and_the_session_goes_on(server):
    with live(server) as session:
        begin(session, frames="json")
        told = []
        wrong = {"emotion": "glad"}, {"seed": 3}, {"gain": {"nose of": 2}}, {"intensity": 10**400}
        for change in (*wrong, {"intensity": 1.5}):
            session.send(json.dumps({"type": "set", **change}))
        session.send(np.zeros(16000, "<i2").tobytes())
        session.send('{"type": "stop"}')
        while (message := json.loads(session.recv(PATIENCE)))["type"] != "end":
            told += [message["code"]] if message["type"] == "problem" else []
    assert told == ["emotion_invalid", "option_invalid", "control_invalid", "option_invalid"]
    assert message["frames"] == 30


def test_error_of_one_session_ends_no_other(server):
    """What only the worker knows of a model, such as its styles, is refused there."""
    with live(server) as session:
        begin(session, frames="json")
        for wrong in ({"style": "nobody"}, {"gain": {"nose of": 2}}):
            with live(server) as other:
                assert begin(other, **wrong)["code"] in ("model_unfit", "control_invalid")
        session.send(np.zeros(16000, "<i2").tobytes())
        session.send('{"type": "stop"}')
        while (message := json.loads(session.recv(PATIENCE)))["type"] == "frames":
            pass
    assert message == {"type": "end", "frames": 30}


def test_messages_without_a_whole_sample_take_no_memory():
    stream = LiveStream(RATE, False, SimpleNamespace(feed=lambda chunk: None))
    stream.feed(bytes(3200))
    kept = len(stream._arrivals)
    for _ in range(100):
        stream.feed(b"")
    assert len(stream._arrivals) == kept


@pytest.mark.parametrize("sound", [b"", b"\0"])
def test_session_without_sound_ends(server, sound):
    with live(server) as session:
        begin(session)
        session.send(sound)
        session.send('{"type": "stop"}')
        assert json.loads(session.recv(PATIENCE)) == {"type": "end", "frames": 0}
        with pytest.raises(ConnectionClosed):
            session.recv(PATIENCE)


def test_messages_beyond_the_size_close_the_connection(server):
    with live(server) as session:
        begin(session)
        with pytest.raises(ConnectionClosed) as closed:
            session.send(bytes(2_000_000))
            session.recv(PATIENCE)
    # RFC 6455: message too big; a reset of what was not read may come before the reason.
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1009


def resident_mb(pid: int) -> float:
    with open(f"/proc/{pid}/status") as file:
        (line,) = (line for line in file if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def test_flood_of_sound_ends_the_session_and_takes_no_memory(server):
    before = resident_mb(server.process.pid)
    second = bytes(2 * RATE)
    with live(server) as session:
        begin(session)
        with pytest.raises(ConnectionClosed):
            for _ in range(3000):
                session.send(second * 10)
                with suppress(TimeoutError):
                    while True:
                        session.recv(0)
    assert resident_mb(server.process.pid) < before + 50  # one message is 0.3 MB


def test_sessions_beyond_the_limit_and_other_sites_are_refused(server, keyed_server):
    with pytest.raises(InvalidStatus) as refused:
        with live(server, origin="https://evil.example"):
            pass
    assert refused.value.response.status_code == 403
    with pytest.raises(InvalidStatus) as refused:
        with live(keyed_server):
            pass
    assert refused.value.response.status_code == 401
    with pytest.raises(InvalidStatus):
        with live(keyed_server, additional_headers=bearer("viewer")):
            pass
    wait_for(lambda: keyed_server.metric("live_sessions", bearer("farm")) == 0)
    with live(keyed_server, additional_headers=bearer("farm")) as session:
        assert begin(session)["type"] == "header"
    wait_for(lambda: keyed_server.metric("live_sessions", bearer("farm")) == 0)
    key = bearer("farm")["Authorization"].removeprefix("Bearer ")
    with live(keyed_server, subprotocols=["deitalk", f"deitalk.key.{key}"]) as session:
        assert session.subprotocol == "deitalk" and key not in str(session.response)
        assert begin(session)["type"] == "header"
    wait_for(lambda: server.metric("live_sessions") == 0)
    with ExitStack() as sessions:
        for _ in range(Settings.model_fields["live_sessions"].default // 2):
            sessions.enter_context(live(server))
        with pytest.raises(InvalidStatus, match="429"):  # the other half is for other addresses
            sessions.enter_context(live(server))
    wait_for(lambda: server.metric("live_sessions") == 0)
    with live(server) as session:
        assert begin(session)["type"] == "header"


def frames_of(session):
    found = []
    while isinstance(message := session.recv(PATIENCE), bytes):
        found += records(message, 185)
    return found, json.loads(message)


def test_causal_model_gives_the_frames_of_live_animator(server, tiny_model):
    sound = pcm(3.0)
    given = {"model": "tiny", "emotion": "happy", "life": "off", "seed": 0, "variant": "plain"}
    with live(server) as session:
        header = begin(session, **given)
        assert header["lookahead_seconds"] <= 0.202 and header["head"] == []
        with live(server) as other:
            assert begin(other, **given)["type"] == "header"
            for start in range(0, len(sound), 3000):
                session.send(sound[start : start + 3000])
                other.send(sound[start : start + 1000])
            session.send('{"type": "stop"}')
            session.send('{"type": "stop"}')
        found, end = frames_of(session)
    assert end == {"type": "end", "frames": 90}
    assert [index for index, *_ in found] == list(range(90))
    assert [at for _, _, at, _ in found] == pytest.approx([k / 30 for k in range(90)])
    assert all(late >= 0 for _, late, _, _ in found)
    animator = LiveAnimator(tiny_model, emotion="happy", life="off", variant="plain")
    expected = np.concatenate((animator.feed(sound), animator.finish()))
    assert np.abs(np.array([values for *_, values in found]) - expected).max() < 1e-4


@pytest.mark.parametrize("frames", ["binary", "json"])
def test_head_and_life_are_those_of_live_animator(server, tiny_model, frames):
    sound = pcm(2.0)
    with live(server) as session:
        header = begin(
            session, model="tiny", frames=frames, head=True, life="brows=.5,head=2", seed=7
        )
        session.send(sound)
        session.send('{"type": "stop"}')
        values = []
        while True:
            message = session.recv(PATIENCE)
            if isinstance(message, bytes):
                values += [row for *_, row in records(message, 191)]
            elif (found := json.loads(message))["type"] == "frames":
                values += [frame["values"] + frame["head"] for frame in found["frames"]]
            else:
                break
    assert header["head"] == ["yaw", "pitch", "roll", "x", "y", "z"]
    animator = LiveAnimator(tiny_model, life={"brows": 0.5, "head": 2}, seed=7)
    expected = [np.concatenate((animator.feed(sound), animator.head), axis=1)]
    expected.append(np.concatenate((animator.finish(), animator.head), axis=1))
    expected = np.concatenate(expected)
    assert expected[:, 185:].std(axis=0).min() > 0
    np.testing.assert_allclose(np.array(values), expected, atol=2e-4)


def test_client_that_does_not_read_is_cut_off_in_time(monkeypatch):
    """Neither its connection nor the application's task outlasts the time for a message."""
    monkeypatch.setattr(protocol.GuardedSocket, "read_seconds", 0.5)
    ended = threading.Event()

    async def app(scope, receive, send):
        assert scope["type"] == "websocket"
        await send({"type": "websocket.accept"})
        try:
            while True:
                await send({"type": "websocket.send", "bytes": bytes(1 << 16)})
        except OSError:  # uvicorn's ClientDisconnected
            ended.set()

    port = free_port()
    config = server_config(app, Settings(port=port))
    config.lifespan = "off"
    running = uvicorn.Server(config)
    thread = threading.Thread(target=running.run)
    thread.start()
    try:
        while not running.started:
            time.sleep(0.01)
        url = f"ws://127.0.0.1:{port}/v1/live"
        with connect(url, proxy=None, max_queue=1, close_timeout=0.1) as session:
            assert ended.wait(30)
            with pytest.raises(ConnectionClosed):
                while True:
                    session.recv(PATIENCE)
    finally:
        running.should_exit = True
        thread.join()


class StuckSocket:
    """A WebSocket whose client takes nothing, and whose transport waits for it for ever."""

    def __init__(self):
        async def check_quota(caller):
            return None

        service = SimpleNamespace(check_quota=check_quota, live=Places(1))
        self.scope, self.state = {}, SimpleNamespace(caller=CALLER)
        self.app = SimpleNamespace(state=SimpleNamespace(service=service))

    async def accept(self, subprotocol=None):
        return None

    async def receive(self):
        return {"type": "websocket.receive", "text": '{"type": "start"}'}

    async def send_text(self, text):
        await asyncio.Event().wait()

    async def close(self, code=1000):
        await asyncio.Event().wait()


@pytest.mark.parametrize("fault", [None, Problem(413, "too long"), ValueError()])
def test_end_of_a_session_does_not_wait_for_its_client(monkeypatch, fault):
    async def run(self):
        if fault is not None:
            raise fault

    monkeypatch.setattr(live_route, "SEND_SECONDS", 0.05)
    monkeypatch.setattr(live_route.Session, "run", run)
    asyncio.run(asyncio.wait_for(live_route.live(StuckSocket()), 60))


DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize(
    ("name", "key", "is_fast", "rate", "channels"),
    [
        ("server", "", True, 44_100, 2),
        pytest.param("keyed_server", KEYS["anna"], False, 16_000, 1, marks=pytest.mark.thorough),
    ],
)
def test_documented_client_in_python_gets_every_frame(
    name, key, request, tmp_path, is_fast, rate, channels
):
    """With a key too; of a file with a header, whose channels are mixed."""
    client = runpy.run_path(str(DOCS / "live_client.py"))
    (tmp_path / "a.wav").write_bytes(wav(2.0, rate, channels))
    url = f"{request.getfixturevalue(name).url.replace('http', 'ws')}/v1/live"
    given = list(client["frames"](url, str(tmp_path / "a.wav"), key, is_fast=is_fast))
    assert [time for time, _ in given] == pytest.approx(np.arange(60) / 30)
    assert all(len(curves) == 185 for _, curves in given)


def test_documented_client_sends_more_than_a_message_and_says_why_it_is_refused(
    keyed_server, server, tmp_path
):
    """The service takes a mebibyte in one: 32.8 s."""
    (tmp_path / "a.wav").write_bytes(wav(34.0))

    def run(running, *options):
        url = f"{running.url.replace('http', 'ws')}/v1/live"
        command = [sys.executable, DOCS / "live_client.py", tmp_path / "a.wav", "--url", url]
        return subprocess.run(
            [*command, "--fast", *options], capture_output=True, text=True, timeout=300
        )

    done = run(keyed_server, "--key", KEYS["anna"])
    assert done.returncode == 0 and len(done.stdout.splitlines()) == 1020, done.stderr
    for refused, said in ((run(keyed_server), "401"), (run(server), "sessions last 20 s")):
        assert refused.returncode and said in refused.stderr.splitlines()[-1]


def test_documented_client_of_a_browser_gets_every_frame(keyed_server):
    """Of a WAV that the browser decodes, longer than a message may be, with a key."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("needs Debian's chromium")
    url = f"{keyed_server.url.replace('http', 'ws')}/v1/live"
    script = f"""async (text) => {{
        {(DOCS / "live_client.js").read_text()}
        const file = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]);
        let seen = 0;
        const options = {{ key: "{KEYS["anna"]}", fast: true, onFrame: () => seen++ }};
        const given = (await frames("{url}", await samples(file), options)).frames;
        return [given.length, seen, given.at(-1).time, given.at(-1).values.length];
    }}"""
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        tab = browser.new_context(bypass_csp=True).new_page()
        tab.goto(f"{keyed_server.url}/healthz")
        count, seen, last, controls = tab.evaluate(script, b64encode(wav(34.0)).decode())
        browser.close()
    assert (count, seen, controls) == (1020, 1020, 185)
    assert last == pytest.approx(34 - 1 / 30)


def test_eyes_turn_when_the_listener_moves(server):
    with live(server) as session:
        given = {"frames": "json", "sample_rate": 48_000, "life": "blinks=0,gaze=0"}
        names = begin(session, **given)["names"]
        session.send(pcm(1.5, 48_000))
        session.send(json.dumps({"type": "set", "look_at": "25,0", "emotion": "angry=0.5"}))
        session.send(pcm(1.5, 48_000))
        session.send(json.dumps({"type": "stop"}))
        frames = []
        while (message := json.loads(session.recv(PATIENCE)))["type"] == "frames":
            frames += message["frames"]
    assert message == {"type": "end", "frames": 90}
    assert [frame["index"] for frame in frames] == list(range(90))
    eyes = [name for name in names if "eye.tx" in name.lower()]
    side = np.abs([[frame["values"][names.index(name)] for name in eyes] for frame in frames]).max(
        1
    )
    assert side[-10:].min() > 0.2 + side[:30].max()


def until_interrupted(session):
    """Records before an interruption, its message, and those after it up to the frame of sound."""
    before, after = [], []
    while isinstance(message := session.recv(PATIENCE), bytes):
        before += records(message, 185)
    told = json.loads(message)
    assert told["type"] == "interrupted", told
    while len(after) < 5:
        after += records(session.recv(PATIENCE), 185)
    return before, told, after


@pytest.mark.parametrize("frame", [None, 40])
def test_interrupted_voice_shuts_its_mouth_without_more_sound(server, frame):
    with live(server) as session:
        header = begin(session, emotion="happy")
        session.send(pcm(2.0))
        seen = 0
        while seen < 45:
            seen += len(list(records(session.recv(PATIENCE), 185)))
        given = {} if frame is None else {"frame": frame}
        session.send(json.dumps({"type": "interrupt", **given}))
        _, told, after = until_interrupted(session)
        assert told["frame"] == after[0][0] and told["next"] > told["frame"]
        parts = ("jaw.ty", "funnel", "purse", "LipRaise", "lowerLipDepress")
        mouth = [k for k, n in enumerate(header["names"]) if any(part in n for part in parts)]
        assert max(np.abs(values[mouth]).max() for _, _, _, values in after[2:]) < 1e-6
        session.send(pcm(1.0))
        session.send('{"type": "stop"}')
        while isinstance(message := session.recv(PATIENCE), bytes):
            after += records(message, 185)
    assert json.loads(message) == {"type": "end", "frames": told["next"] + 30}
    assert [index for index, *_ in after] == list(range(told["frame"], told["next"] + 30))


@pytest.mark.parametrize(
    "fields", [{"frame": 10**6}, {"frame": -1}, {"frame": "x"}, {"frame": 1.5}, {"now": True}]
)
def test_wrong_interruption_is_answered_and_changes_nothing(server, fields):
    with live(server) as session:
        begin(session)
        session.send(pcm(1.0))
        session.send(json.dumps({"type": "interrupt", **fields}))
        session.send('{"type": "stop"}')
        problems, count = [], 0
        while (message := session.recv(PATIENCE)) and (
            isinstance(message, bytes) or json.loads(message)["type"] == "problem"
        ):
            if isinstance(message, bytes):
                count += len(list(records(message, 185)))
            else:
                problems.append(json.loads(message))
        assert len(problems) == 1 and "frame" in problems[0]["message"]
        assert json.loads(message) == {"type": "end", "frames": count} and count == 30
