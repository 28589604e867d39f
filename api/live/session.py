"""A session of `WS /v1/live`: sound in, frames out, read and sent each at its own pace."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

from fastapi import WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from api.compute.live import Interrupted
from api.errors import Problem, problem_of
from api.guard.keys import Caller
from api.guard.protocol import SEND_SECONDS
from api.live.messages import Start, acting_of, frames_message, header_message, problem_message
from api.live.stream import LiveStream
from api.service import Service
from deitalk.acting import LIVE_FIELDS, Acting, user_error
from deitalk.errors import ConfigError
from deitalk.models.folder import is_causal, model_folder, product_of, read_about
from rig.conversion.convert import known_controls
from rig.curves import HEAD
from rig.curves.edit import gain_factors
from rig.errors import UserError

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
        try:
            self.start = Start.model_validate(own)
        except ValidationError as error:
            raise Problem(422, str(user_error(error)), "option_invalid") from None
        self.acting = acting_of(content)
        folder = self._model_folder()
        self.controls = known_controls(read_about(folder)["control_set"])
        if not self.start.head:  # the eyes do not turn against a head that is not sent
            life = replace(self.acting.life, head=0.0)
            self.acting = Acting.of(self.acting, life=life)
        voice, lookahead = await self.service.voices.open(self.start.model, self.acting)
        self.lookahead = lookahead
        try:
            is_float = self.start.encoding == "float32"
            longest, late = self.service.settings.live_seconds, self.service.metrics.late.observe
            self.stream = LiveStream(self.start.sample_rate, is_float, voice, longest, late)
            await self._send(header_message(folder, lookahead, [*HEAD] if self.start.head else []))
            await self._serve()
        finally:
            voice.close()

    async def _serve(self) -> None:
        """Read and write until one of the two ends."""
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
            values, head = frames[:, : -len(HEAD)], frames[:, -len(HEAD) :]
            shown = head if self.start.head else None
            await self._send(frames_message(begin, values, late, as_json=as_json, head=shown))

    async def _read(self) -> None:
        """Take messages; none while too much sound waits."""
        while not self.stream.is_whole:
            await self.stream.wait_for_room()
            message = await self._message(QUIET_SECONDS)
            self.stream.check_length()
            if (data := message.get("bytes")) is not None:
                self.stream.feed(data)
            else:
                await self._command(message["text"])

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
                if kind == "set":
                    self._change(content)
                else:
                    frame = content.pop("frame", None)
                    if content or (frame is not None and type(frame) is not int):
                        raise ConfigError("interrupt takes frame alone, a whole number")
                    self.stream.interrupt(self.lookahead, frame)
            except UserError as error:  # the session goes on unchanged
                await self._send(problem_message(problem_of(error)))
        else:
            raise Problem(
                422, "type must be set, interrupt or stop after the start", "message_unknown"
            )

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


def _json(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise Problem(422, "commands are JSON objects", "message_unknown")
    return content
