"""A face behind the sound of a LiveKit agent (extra ``livekit``).

::

    session.output.audio = FaceAudioOutput(session.output.audio, show)

Sound reaches the next output a fifth of a second later, after ``show`` was called with the frames
that belong to it: who counts the sound that was played knows which frame is due.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from deitalk.agents.face import IDLE_SECONDS, AgentFace, Piece
from deitalk.errors import MissingError
from deitalk.live.animator import Emotion

try:
    from livekit import rtc
    from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities
except ImportError as error:
    raise MissingError(
        f"a face in LiveKit Agents needs them ({error}); pip install 'deitalk[livekit]'"
    ) from None

Show = Callable[[Piece], None]
"""Takes frames, in the order in which they are to be shown; after an interruption at once."""


class FaceAudioOutput(AudioOutput):  # type: ignore[misc, unused-ignore]
    """An output of sound that gives curves in step with it, and passes the sound on.

    Parameters
    ----------
    output : AudioOutput
        That plays the sound.
    show : callable
        See `Show`.
    model, emotion, fields
        As for `deitalk.LiveAnimator`.
    idle : bool
        Move the face while it does not speak, by the sound of the user if `listen` is given it.
    """

    def __init__(
        self,
        output: AudioOutput,
        show: Show,
        model: str | Path = "live",
        emotion: Emotion = "neutral",
        *,
        idle: bool = True,
        **fields: Any,
    ) -> None:
        super().__init__(
            label="deitalk face",
            capabilities=AudioOutputCapabilities(pause=False),
            next_in_chain=output,
            sample_rate=output.sample_rate,
        )
        self.face, self.show, self._moves = AgentFace(model, emotion, **fields), show, idle
        self._rate = 0
        self._order = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._turn = 0
        """Counts interruptions: what was begun before one is dropped."""

    async def capture_frame(self, frame: "rtc.AudioFrame") -> None:
        """Take sound of the voice, faster than it is played."""
        await super().capture_frame(frame)
        turn, self._rate = self._turn, frame.sample_rate
        arguments = bytes(frame.data), frame.sample_rate, frame.num_channels
        async with self._order:
            pieces = await asyncio.to_thread(self.face.speak, *arguments)
            if turn == self._turn:
                await self._pass(pieces)

    def flush(self) -> None:
        """Take the end of a turn."""
        super().flush()
        self._start(self._finish(self._turn))

    def clear_buffer(self) -> None:
        """Interrupt the voice: the mouth shuts within 0.1 s."""
        self._turn += 1
        if self.next_in_chain is not None:
            self.next_in_chain.clear_buffer()
        for piece in self.face.interrupt():
            self.show(piece)

    def listen(self, frame: "rtc.AudioFrame") -> None:
        """Take sound of the user."""
        self.face.listen(bytes(frame.data), frame.sample_rate, frame.num_channels)

    def on_attached(self) -> None:
        """Begin to move."""
        super().on_attached()
        if self._moves:
            self._start(self._idle())

    def on_detached(self) -> None:
        """Stop moving."""
        for task in self._tasks:
            task.cancel()
        super().on_detached()

    def _start(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _finish(self, turn: int) -> None:
        async with self._order:
            if turn != self._turn:
                return
            await self._pass(await asyncio.to_thread(self.face.end))
            if self.next_in_chain is not None:
                self.next_in_chain.flush()

    async def _idle(self) -> None:
        with suppress(asyncio.CancelledError):
            while True:
                await asyncio.sleep(IDLE_SECONDS)
                async with self._order:
                    turn = self._turn
                    pieces = await asyncio.to_thread(self.face.idle)
                    if turn == self._turn:
                        await self._pass(pieces)

    async def _pass(self, pieces: list[Piece]) -> None:
        """Show frames, and pass on the sound of their time."""
        for piece in pieces:
            self.show(piece)
            if piece.sound and self.next_in_chain is not None:
                count = len(piece.sound) // 2
                frame = rtc.AudioFrame(piece.sound, self._rate, 1, count)
                await self.next_in_chain.capture_frame(frame)
