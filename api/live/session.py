"""One session of `WS /v1/live`: reads, animates and sends, each at its own pace."""

import asyncio
import json
import struct
from collections.abc import Callable, Coroutine
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, Literal

import numpy as np
from fastapi import WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocketDisconnect

from api.compute.live import MODEL, Voice
from api.compute.order import ACTING, RECORDING, Order
from api.compute.pool import result_path
from api.errors import Problem
from api.guard.keys import Caller
from api.guard.protocol import SEND_SECONDS
from api.live.stream import (
    BACKLOG_SECONDS,
    HOP_SECONDS,
    LOOKAHEAD_SECONDS,
    WINDOW_SECONDS,
    LiveStream,
)
from api.service import Service
from deitalk.acting import LIVE_FIELDS, Acting, modern, user_error
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.errors import ConfigError
from deitalk.models.folder import is_causal, model_folder, product_of, read_about
from rig.arrays import Float32
from rig.curves import HEAD

# Messages of `WS /v1/live`.
#
# ::
#
#     client   {"type": "start", "sample_rate": 48000, "encoding": "pcm16", "frames": "binary", …}
#     server   {"type": "header", "names": […], "head": […], "fps": 30, "lookahead_seconds": 0.2, …}
#     client   samples as bytes, any number a message       {"type": "set", "emotion": "sad"}
#     server   frames as bytes or {"type": "frames", …}
#     client   {"type": "stop"}
#     server   the last frames, {"type": "end", "frames": 421}

FRAME = struct.Struct("<Ifd")
"""Number of the frame, seconds between its sound and this message, its time in the sound."""


class Start(BaseModel):
    """The first message, but for its acting; `head` is for causal models."""

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
    return Acting.of(before, files={}, **modern(fields)[0]).check_live()


def frames_message(
    first: int,
    values: Float32,
    late: list[float],
    fps: float,
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
    fps : float
        Frames per second.
    as_json : bool
        A mapping for JSON; else records of `FRAME` and C little-endian float32.
    head : array [shape=(T, 6)], optional
        Track of the head: ``head`` of a frame in JSON, the last six numbers of a record.
    """
    if not as_json:
        rows = (values if head is None else np.concatenate((values, head), axis=1)).astype("<f4")
        return b"".join(
            FRAME.pack(first + k, late[k], (first + k) / fps) + rows[k].tobytes()
            for k in range(len(rows))
        )
    listed = [
        {
            "index": first + k,
            "time": (first + k) / fps,
            "late": round(late[k], 4),
            "values": np.round(values[k].astype(float), 5).tolist(),
        }
        | ({} if head is None else {"head": np.round(head[k].astype(float), 4).tolist()})
        for k in range(len(values))
    ]
    return {"type": "frames", "frames": listed}


class CausalStream(LiveStream):
    """A stream whose sound goes to a voice as it comes; parameters as for `LiveStream`.

    Parameters
    ----------
    sample_rate : int
    is_float : bool
    voice : Voice
    """

    def __init__(self, sample_rate: int, is_float: bool, voice: Voice) -> None:
        super().__init__(sample_rate, is_float)
        self.voice = voice

    @property
    def backlog_seconds(self) -> float:
        """Sound whose frames have not come."""
        return self.seconds - self.next_frame / FRAME_RATE

    @property
    def is_done(self) -> bool:
        """Whether all frames of the whole sound have come."""
        return self.is_whole and self.next_frame >= self.n_frames

    def finish(self) -> None:
        """Take the end of the sound."""
        super().finish()
        self.voice.finish()

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
        sample = self.next_frame * SAMPLE_RATE // FRAME_RATE
        self._arrivals = [arrival for arrival in self._arrivals if arrival[0] >= sample]
        return begin, late

    def _append(self, chunk: Float32) -> None:
        self.begin += len(chunk)
        self._arrivals.append((self.begin, monotonic()))
        self.voice.feed(np.asarray(chunk, np.float32))


START_SECONDS = 10.0
QUIET_SECONDS = 60.0
"""Time without a message after which a session ends."""
TEXT_CHARACTERS = 4096
TEXTS_PER_SECOND, TEXTS_AT_ONCE = 20.0, 40.0
SHORTEST_SAMPLES = 1600


class Session:
    """A client's session.

    Parameters
    ----------
    websocket : WebSocket
        Accepted.
    service : Service
    caller : Caller
    folder : Path
        Of the session's orders.
    """

    def __init__(
        self, websocket: WebSocket, service: Service, caller: Caller, folder: Path
    ) -> None:
        self.websocket, self.service, self.folder = websocket, service, folder
        self.caller = caller
        self.news = asyncio.Event()
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
        content = _json(await self._text(START_SECONDS))
        content.pop("type", None)
        own = {name: content.pop(name) for name in Start.model_fields if name in content}
        self.start, self.acting = _parsed(own), acting_of(content)
        folder = self._model_folder()
        if not is_causal(folder):
            stream = LiveStream(self.start.sample_rate, self.start.encoding == "float32")
            with self.service.windows():
                await self._serve(folder, stream, self._write, HOP_SECONDS, LOOKAHEAD_SECONDS)
            return
        if not self.start.head:  # the eyes do not turn against a head that is not sent
            life = replace(self.acting.life, head=0.0)
            self.acting = Acting.of(self.acting, life=life)
        voice, lookahead = await self.service.voices.open(self.start.model, self.acting)
        try:
            causal = CausalStream(self.start.sample_rate, self.start.encoding == "float32", voice)
            await self._serve(
                folder, causal, partial(self._pass_on, causal), 1 / FRAME_RATE, lookahead
            )
        finally:
            voice.close()

    async def _serve(
        self,
        folder: Path,
        stream: LiveStream,
        write: Callable[[], Coroutine[Any, Any, None]],
        hop: float,
        lookahead: float,
    ) -> None:
        """Read and write until one of the two ends; `hop` and `lookahead` are for the header."""
        self.stream = stream
        await self._send(_header(folder, hop, lookahead, self._head_columns(folder)))
        self.stream.change(self.acting)
        self.end = monotonic() + self.service.settings.live_seconds
        reading = asyncio.create_task(self._read())
        writing = asyncio.create_task(write())
        try:
            await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_EXCEPTION)
            for task in (reading, writing):
                if task.done():
                    task.result()
        finally:
            for task in (reading, writing):
                task.cancel()
            await self.service.count_live(self.caller, self.stream.seconds)
        await self._send({"type": "end", "frames": self.stream.next_frame})

    def _model_folder(self) -> Path:
        models = self.service.settings.known_models
        if self.start.model not in models:
            raise Problem(404, f"no such model; known models: {', '.join(models)}", "model_unknown")
        folder = models[self.start.model]
        if product_of(folder) != "curves":
            raise Problem(422, "the model makes no curves; use default", "model_unfit")
        return model_folder(folder)

    def _head_columns(self, folder: Path) -> list[str]:
        return [*HEAD] if self.start.head and is_causal(folder) else []

    async def _pass_on(self, stream: CausalStream) -> None:
        """Send the frames of a voice as they come."""
        as_json = self.start.frames == "json"
        while not stream.is_done:
            frames = await stream.voice.next_frames()
            begin, late = stream.come(frames)
            self._observe(late)
            self.room.set()
            values, head = frames[:, : -len(HEAD)], frames[:, -len(HEAD) :]
            message = frames_message(
                begin,
                values,
                late,
                FRAME_RATE,
                as_json=as_json,
                head=head if self.start.head else None,
            )
            await self._send(message)

    def _observe(self, late: list[float]) -> None:
        for seconds in late:
            self.service.metrics.late.observe(seconds)

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
                self._command(message["text"])
            if self.stream.backlog_seconds > BACKLOG_SECONDS:
                self.room.clear()
            self.news.set()

    async def _write(self) -> None:
        """Animate windows that are due and send their frames."""
        while True:
            if not self.stream.is_due:
                if self.stream.is_whole:
                    return
                await self.news.wait()
                self.news.clear()
                continue
            first, samples, fields = self.stream.window()
            self.room.set()
            values = await self._animated(samples, fields)
            begin, frames, late = self.stream.take(first, values)
            if len(frames):
                self._observe(late)
                as_json = self.start.frames == "json"
                await self._send(frames_message(begin, frames, late, FRAME_RATE, as_json=as_json))

    async def _animated(self, samples: Float32, fields: dict[str, Any]) -> Float32:
        padded = np.pad(samples, (0, max(0, SHORTEST_SAMPLES - len(samples))))
        padded.astype("<f4").tofile(self.folder / RECORDING)
        (self.folder / ACTING).write_text(json.dumps(fields))
        order: Order = {
            "kind": "live",
            "folder": str(self.folder),
            "options": {"model": self.start.model},
        }
        answer = await self.service.pool.run(order, self.caller)
        values = np.fromfile(result_path(self.folder, answer), "<f4")
        rows = values.reshape(answer["facts"]["frames"], -1).astype(np.float32)
        return rows[: -(-len(samples) * FRAME_RATE // 16_000)]

    def _command(self, text: str) -> None:
        now = monotonic()
        self._texts = min(TEXTS_AT_ONCE, self._texts + (now - self._since) * TEXTS_PER_SECOND) - 1
        self._since = now
        if self._texts < 0:
            raise Problem(429, f"more than {TEXTS_PER_SECOND:g} commands a second")
        content = _json(text)
        kind = content.pop("type", None)
        if kind == "stop" and not content:
            self.stream.finish()
        elif kind == "set":
            self._change(content)
        else:
            raise Problem(422, "type must be set or stop after the start", "message_unknown")

    def _change(self, fields: dict[str, Any]) -> None:
        fields, _ = modern(fields)
        if fixed := [name for name in fields if LIVE_FIELDS.get(name, "change") != "change"]:
            raise ConfigError(f"{', '.join(fixed)} cannot change while somebody speaks")
        self.acting = acting_of(fields, self.acting)
        self.stream.change(self.acting)

    async def _text(self, seconds: float) -> str:
        message = await self._message(seconds)
        if message.get("text") is None:
            raise Problem(422, "the first message is the start, as JSON", "message_unknown")
        return str(message["text"])

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


def _header(folder: Path, hop: float, lookahead: float, head: list[str]) -> dict[str, Any]:
    about = read_about(folder)
    return {
        "type": "header",
        "names": about["controls"],
        "control_set": about["control_set"],
        "head": head,
        "fps": FRAME_RATE,
        "lookahead_seconds": lookahead,
        "hop_seconds": hop,
        "window_seconds": WINDOW_SECONDS if lookahead == LOOKAHEAD_SECONDS else lookahead,
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
