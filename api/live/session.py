"""`WS /v1/live`: sound in, frames out, read and sent each at its own pace."""

import asyncio
import json
import struct
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any, Literal

import numpy as np
import soxr
from fastapi import APIRouter, WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocketDisconnect

from api.compute.live import MODEL, Interrupted, Voice
from api.errors import Problem, problem_for, problem_of
from api.guard.keys import Caller, require
from api.guard.middleware import SUBPROTOCOL
from api.guard.protocol import SEND_SECONDS
from api.service import Service
from deitalk.acting import LIVE_FIELDS, Acting, user_error
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, samples_within
from deitalk.errors import ConfigError
from deitalk.models.folder import is_causal, model_folder, product_of, read_about
from rig.arrays import Float32
from rig.conversion.convert import known_controls
from rig.curves import HEAD
from rig.curves.edit import gain_factors
from rig.errors import UserError

# Sound of a client to a voice as it comes, and the frames of the voice with their times.


BACKLOG_SECONDS = 5.0
"""Sound that waits; while there is more, the connection is not read."""
KEPT_FRAMES = 20 * FRAME_RATE
"""Last frames that a client may name as shown when it interrupts the voice."""


class LiveStream:
    """Sound, changes and frames of one session.

    Parameters
    ----------
    sample_rate : int
        Of the client, Hz.
    is_float : bool
        Whether samples are float32; else 16-bit integers. Both little-endian, mono.
    voice : Voice
        What animates it.

    Attributes
    ----------
    end : int
        Samples at 16 kHz that have come.
    next_frame : int
        Frames that have come from the voice.
    is_whole : bool
        Whether the sound has ended.
    """

    def __init__(self, sample_rate: int, is_float: bool, voice: Voice) -> None:
        self.sample_rate, self.is_float, self.voice = sample_rate, is_float, voice
        self.end = self.next_frame = 0
        self.is_whole = False
        self._kept: deque[Float32] = deque(maxlen=KEPT_FRAMES)
        self._rest = b""
        self._begin()
        self._arrivals: list[tuple[int, float]] = []

    @property
    def seconds(self) -> float:
        """Sound that has come."""
        return self.end / SAMPLE_RATE

    @property
    def backlog_seconds(self) -> float:
        """Sound whose frames have not come."""
        return self.seconds - self.next_frame / FRAME_RATE

    @property
    def n_frames(self) -> int:
        """Frames of the sound that has come."""
        return -(-self.end * FRAME_RATE // SAMPLE_RATE)

    @property
    def is_done(self) -> bool:
        """Whether all frames of the whole sound have come."""
        return self.is_whole and self.next_frame >= self.n_frames

    def feed(self, data: bytes) -> None:
        """Take samples; a part of one is kept for the next call.

        Raises
        ------
        Problem
            422 for samples that are not finite.
        """
        data = self._rest + data
        size = 4 if self.is_float else 2
        whole = len(data) - len(data) % size
        self._rest = data[whole:]
        if self.is_float:
            chunk = np.frombuffer(data[:whole], "<f4").astype(np.float32)
            if not np.isfinite(chunk).all() or (np.abs(chunk) > 1e6).any():
                raise Problem(422, "samples must be finite, within 1", "audio_unusable")
        else:
            chunk = np.frombuffer(data[:whole], "<i2").astype(np.float32) / np.float32(32768)
        chunk = self._resampler.resample_chunk(chunk)
        if len(chunk):  # messages without a sample are not kept
            self._append(chunk)

    def _begin(self) -> None:
        """Forget what the next samples would be joined to."""
        self._resampler = soxr.ResampleStream(self.sample_rate, SAMPLE_RATE, 1, dtype="float32")
        self._rest = b""

    def interrupt(self, lookahead: float, frame: int | None = None) -> None:
        """Stop the voice: the mouth shuts, silence follows; see `LiveAnimator.interrupt`.

        Parameters
        ----------
        lookahead : float
            Of the model, seconds.
        frame : int, optional
            Number of the frame that is shown; by default the one that was given last.

        Raises
        ------
        ConfigError
            If that frame was not given, or so long ago that it is not kept.
        """
        shown = None
        if frame is not None:
            first = self.next_frame - len(self._kept)
            if not first <= frame < self.next_frame:
                raise ConfigError(f"frame {frame} is none of {first} to {self.next_frame - 1}")
            shown = self._kept[frame - first]
        self._begin()
        if self.end:
            self.end += samples_within(lookahead)
            self._arrivals.append((self.end, monotonic()))
        self.voice.interrupt(shown)

    def finish(self) -> None:
        """Take the end of the sound."""
        self._append(self._resampler.resample_chunk(np.zeros(0, np.float32), last=True))
        self.is_whole = True
        self.voice.finish()
        if self.is_done:  # no frame comes
            self.voice.frames.put_nowait(np.zeros((0, len(HEAD)), np.float32))

    def change(self, acting: Acting) -> None:
        """Act otherwise from the sound on that comes next."""
        fields = acting.model_dump(mode="json", include=acting.model_fields_set)
        self.voice.change({n: v for n, v in fields.items() if LIVE_FIELDS.get(n) == "change"})

    def come(self, frames: Float32) -> tuple[int, list[float]]:
        """Take the next frames.

        Returns
        -------
        first : int
            Number of the first of them.
        late : list of float
            Seconds since each frame's sound came.
        """
        begin, now = self.next_frame, monotonic()
        late = [now - self._arrival(begin + k) for k in range(len(frames))]
        self.next_frame += len(frames)
        self._kept.extend(frames)
        sample = self.next_frame * SAMPLE_RATE // FRAME_RATE
        self._arrivals = [arrival for arrival in self._arrivals if arrival[0] >= sample]
        return begin, late

    def _append(self, chunk: Float32) -> None:
        self.end += len(chunk)
        self._arrivals.append((self.end, monotonic()))
        self.voice.feed(np.asarray(chunk, np.float32))

    def _arrival(self, frame: int) -> float:
        """Time at which the last sample of a frame came."""
        sample = (frame + 1) * SAMPLE_RATE // FRAME_RATE
        return next((at for end, at in self._arrivals if end >= sample), self._arrivals[-1][1])


# Messages of `WS /v1/live`.
#
# ::
#
#     client   {"type": "start", "sample_rate": 48000, "encoding": "pcm16", "frames": "binary", …}
#     server   {"type": "header", "names": […], "head": […], "fps": 30, "lookahead_seconds": 0.2, …}
#     client   samples as bytes, any number a message       {"type": "set", "emotion": "sad"}
#     server   frames as bytes or {"type": "frames", …}
#     client   {"type": "interrupt", "frame": 372}
#     server   {"type": "interrupted", "frame": 380, "next": 389}, frames of a mouth that shuts
#     client   {"type": "stop"}
#     server   the last frames, {"type": "end", "frames": 421}

FRAME = struct.Struct("<Ifd")
"""Number of the frame, seconds between its sound and this message, its time in the sound."""


class Start(BaseModel):
    """The first message, but for its acting."""

    model_config = ConfigDict(extra="forbid")

    sample_rate: int = Field(default=16_000, ge=8_000, le=192_000)
    encoding: Literal["pcm16", "float32"] = "pcm16"
    frames: Literal["binary", "json"] = "binary"
    model: str = Field(default=MODEL, max_length=64)
    head: bool = False


def acting_of(fields: dict[str, Any], before: Acting | None = None) -> Acting:
    """The acting of a message's fields; those that it does not give are those before.

    Raises
    ------
    UserError
        If a field is unknown, wrong, or needs the whole recording.
    """
    return Acting.of(before, files={}, **fields).check_live()


def frames_message(
    first: int,
    values: Float32,
    late: list[float],
    *,
    as_json: bool,
    head: Float32 | None = None,
) -> bytes | dict[str, Any]:
    """Return consecutive frames as one message.

    Parameters
    ----------
    first : int
        Number of the first frame.
    values : array [shape=(T, C)]
        Curves.
    late : list of float
        Seconds between the arrival of each frame's sound and now.
    as_json : bool
        A mapping for JSON; else records of `FRAME` and C little-endian float32.
    head : array [shape=(T, 6)], optional
        Track of the head: ``head`` of a frame in JSON, the last six numbers of a record.
    """
    if not as_json:
        rows = (values if head is None else np.concatenate((values, head), axis=1)).astype("<f4")
        return b"".join(
            FRAME.pack(first + k, late[k], (first + k) / FRAME_RATE) + rows[k].tobytes()
            for k in range(len(rows))
        )
    listed = [
        {
            "index": first + k,
            "time": (first + k) / FRAME_RATE,
            "late": round(late[k], 4),
            "values": np.round(values[k].astype(float), 5).tolist(),
        }
        | ({} if head is None else {"head": np.round(head[k].astype(float), 4).tolist()})
        for k in range(len(values))
    ]
    return {"type": "frames", "frames": listed}


START_SECONDS = 10.0
QUIET_SECONDS = 60.0
"""Time without a message after which a session ends."""
TEXT_CHARACTERS = 4096
TEXTS_PER_SECOND, TEXTS_AT_ONCE = 20.0, 40.0


class Session:
    """A client's session.

    Parameters
    ----------
    websocket : WebSocket
        Accepted.
    service : Service
    caller : Caller
    """

    def __init__(self, websocket: WebSocket, service: Service, caller: Caller) -> None:
        self.websocket, self.service, self.caller = websocket, service, caller
        self.room = asyncio.Event()
        self.room.set()
        self._texts, self._since = TEXTS_AT_ONCE, monotonic()

    async def run(self) -> None:
        """Serve until the client stops or goes, or breaks a rule.

        Raises
        ------
        Problem
            For a message that is refused.
        WebSocketDisconnect
            If the client has gone, or does not read its frames for `SEND_SECONDS`.
        """
        message = await self._message(START_SECONDS)
        if message.get("text") is None:
            raise _no_start()
        content = _json(str(message["text"]))
        if content.pop("type", "start") != "start":
            raise _no_start()
        own = {name: content.pop(name) for name in Start.model_fields if name in content}
        self.start, self.acting = _parsed(own), acting_of(content)
        folder = self._model_folder()
        self.controls = known_controls(read_about(folder)["control_set"])
        if not self.start.head:  # the eyes do not turn against a head that is not sent
            life = replace(self.acting.life, head=0.0)
            self.acting = Acting.of(self.acting, life=life)
        voice, lookahead = await self.service.voices.open(self.start.model, self.acting)
        self.lookahead = lookahead
        try:
            is_float = self.start.encoding == "float32"
            self.stream = LiveStream(self.start.sample_rate, is_float, voice)
            await self._send(_header(folder, lookahead, [*HEAD] if self.start.head else []))
            await self._serve()
        finally:
            voice.close()

    async def _serve(self) -> None:
        """Read and write until one of the two ends."""
        self.end = monotonic() + self.service.settings.live_seconds
        tasks = {asyncio.create_task(self._read()), asyncio.create_task(self._write())}
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
            for task in tasks:
                if task.done():
                    task.result()
        finally:
            for task in tasks:
                task.cancel()
            await self.service.count_live(self.caller, self.stream.seconds)
        await self._send({"type": "end", "frames": self.stream.next_frame})

    def _model_folder(self) -> Path:
        models = self.service.settings.known_models
        if self.start.model not in models:
            raise Problem(404, f"no such model; known models: {', '.join(models)}", "model_unknown")
        folder = models[self.start.model]
        if product_of(folder) != "curves":
            raise Problem(422, "the model makes no curves; use live", "model_unfit")
        if not is_causal(folder):
            raise Problem(422, "the model needs the whole recording; use live", "model_unfit")
        return model_folder(folder)

    async def _write(self) -> None:
        """Send the frames of the voice as they come."""
        as_json = self.start.frames == "json"
        while not self.stream.is_done:
            frames = await self.stream.voice.next_frames()
            if isinstance(frames, Interrupted):
                place = {"frame": self.stream.next_frame, "next": frames.next_frame}
                await self._send({"type": "interrupted", **place})
                continue
            if not len(frames):
                continue
            begin, late = self.stream.come(frames)
            for seconds in late:
                self.service.metrics.late.observe(seconds)
            self.room.set()
            values, head = frames[:, : -len(HEAD)], frames[:, -len(HEAD) :]
            shown = head if self.start.head else None
            await self._send(frames_message(begin, values, late, as_json=as_json, head=shown))

    async def _read(self) -> None:
        """Take messages; none while too much sound waits."""
        while not self.stream.is_whole:
            await self.room.wait()
            message = await self._message(QUIET_SECONDS)
            if monotonic() > self.end or self.stream.seconds > self.service.settings.live_seconds:
                raise Problem(413, f"sessions last {self.service.settings.live_seconds:g} s")
            if (data := message.get("bytes")) is not None:
                self.stream.feed(data)
            else:
                await self._command(message["text"])
            if self.stream.backlog_seconds > BACKLOG_SECONDS:
                self.room.clear()

    async def _command(self, text: str) -> None:
        """Carry out a text message; a change with a wrong field is answered by a problem."""
        now = monotonic()
        self._texts = min(TEXTS_AT_ONCE, self._texts + (now - self._since) * TEXTS_PER_SECOND) - 1
        self._since = now
        if self._texts < 0:
            raise Problem(429, f"more than {TEXTS_PER_SECOND:g} commands a second")
        content = _json(text)
        kind = content.pop("type", None)
        if kind == "stop" and not content:
            self.stream.finish()
        elif kind in ("set", "interrupt"):
            try:
                self._interrupt(content) if kind == "interrupt" else self._change(content)
            except UserError as error:  # the session goes on unchanged
                await self._send(problem_message(problem_of(error)))
        else:
            raise Problem(
                422, "type must be set, interrupt or stop after the start", "message_unknown"
            )

    def _interrupt(self, fields: dict[str, Any]) -> None:
        frame = fields.pop("frame", None)
        if fields or (frame is not None and type(frame) is not int):
            raise ConfigError("interrupt takes frame alone, a whole number")
        self.stream.interrupt(self.lookahead, frame)

    def _change(self, fields: dict[str, Any]) -> None:
        if fixed := [name for name in fields if LIVE_FIELDS.get(name, "change") != "change"]:
            raise ConfigError(f"{', '.join(fixed)} cannot change while somebody speaks")
        acting = acting_of(fields, self.acting)
        if self.controls is not None:
            gain_factors(self.controls, acting.gain)
        self.acting = acting
        self.stream.change(acting)

    async def _message(self, seconds: float) -> dict[str, Any]:
        try:
            message = await asyncio.wait_for(self.websocket.receive(), seconds)
        except TimeoutError:
            raise Problem(400, f"no message for {seconds:g} s", "session_quiet") from None
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))
        if len(message.get("text") or "") > TEXT_CHARACTERS:
            raise Problem(413, f"commands have at most {TEXT_CHARACTERS} letters")
        return dict(message)

    async def _send(self, message: bytes | dict[str, Any]) -> None:
        sending = (
            self.websocket.send_bytes(message)
            if isinstance(message, bytes)
            else self.websocket.send_text(json.dumps(message))
        )
        try:
            await asyncio.wait_for(sending, SEND_SECONDS)
        except TimeoutError:
            raise WebSocketDisconnect(1008, "the client does not read its frames") from None


def _no_start() -> Problem:
    return Problem(422, "the first message is the start, as JSON", "message_unknown")


def problem_message(problem: Problem) -> dict[str, Any]:
    """Message of a problem."""
    return {"type": "problem", **problem.content}


def _header(folder: Path, lookahead: float, head: list[str]) -> dict[str, Any]:
    about = read_about(folder)
    return {
        "type": "header",
        "names": about["controls"],
        "control_set": about["control_set"],
        "head": head,
        "fps": FRAME_RATE,
        "lookahead_seconds": lookahead,
        "record": "uint32 index, float32 late, float64 time, float32 values, float32 head; "
        "little-endian",
    }


def _json(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise Problem(422, "commands are JSON objects", "message_unknown")
    return content


def _parsed(content: dict[str, Any]) -> Start:
    try:
        return Start.model_validate(content)
    except ValidationError as error:
        raise Problem(422, str(user_error(error)), "option_invalid") from None


# `WS /v1/live`: sound in, frames out.


router = APIRouter()
CLOSE_CODES = {400: 1008, 403: 1008, 404: 1008, 413: 1009, 422: 1007, 429: 1008, 503: 1013}
"""Of WebSocket, by the status of HTTP; others are 1011."""


@router.websocket("/v1/live")
async def live(websocket: WebSocket) -> None:
    """Serve one session; a problem is sent as JSON before the connection is closed."""
    service: Service = websocket.app.state.service
    caller: Caller = websocket.state.caller
    require(caller, "live")
    await service.check_quota(caller)
    with service.live.hold(caller.holder, caller.live):
        is_offered = SUBPROTOCOL in websocket.scope.get("subprotocols", [])
        await websocket.accept(subprotocol=SUBPROTOCOL if is_offered else None)
        await _serve(websocket, service, caller)


async def _serve(websocket: WebSocket, service: Service, caller: Caller) -> None:
    """Serve a session, and close the connection within `SEND_SECONDS`."""
    problem = None
    try:
        await Session(websocket, service, caller).run()
    except WebSocketDisconnect:
        return
    except Exception as error:
        problem = problem_for(error)
    with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
        await asyncio.wait_for(_close(websocket, problem), SEND_SECONDS)


async def _close(websocket: WebSocket, problem: Problem | None) -> None:
    if problem is None:
        await websocket.close()
        return
    await websocket.send_text(json.dumps(problem_message(problem)))
    await websocket.close(CLOSE_CODES.get(problem.status, 1011))
