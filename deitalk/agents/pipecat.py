"""A face in a Pipecat pipeline (extra ``pipecat``).

::

    Pipeline([transport.input(), stt, llm, tts, FaceProcessor(), transport.output(), player])

Sound of the text-to-speech service leaves the processor a fifth of a second later, behind the
frames that belong to it. A transport keeps both in one queue, so that what comes after it (here
``player``) gets each `CurvesFrame` when its sound is played. On an interruption come the frames of
a mouth that shuts; in silence those of a face that listens to the user.
"""

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.agents.face import IDLE_SECONDS, AgentFace, Piece
from deitalk.errors import MissingError
from deitalk.live.animator import Emotion

try:
    from pipecat.frames.frames import (
        CancelFrame,
        DataFrame,
        EndFrame,
        Frame,
        InputAudioRawFrame,
        InterruptionFrame,
        StartFrame,
        TTSAudioRawFrame,
        TTSStoppedFrame,
    )
    from pipecat.processors.frame_processor import FrameDirection, FrameProcessor
except ImportError as error:
    raise MissingError(
        f"a face in Pipecat needs it ({error}); pip install 'deitalk[pipecat]'"
    ) from None


@dataclass
class CurvesFrame(DataFrame):  # type: ignore[misc, unused-ignore]
    """Consecutive frames of a face, to be shown one after another from now on.

    Parameters
    ----------
    first : int
        Number of the first one.
    values : array [shape=(n, 185)]
        Controls, in the order of `FaceProcessor.names`.
    head : array [shape=(n, 6)]
        Turn and shift: degrees and cm.
    fps : float
        Their rate.
    """

    first: int
    values: np.ndarray
    head: np.ndarray
    fps: float = AgentFace.fps


class FaceProcessor(FrameProcessor):  # type: ignore[misc, unused-ignore]
    """Curves of the sound of a text-to-speech service, in step with it.

    Parameters
    ----------
    model, emotion, fields
        As for `deitalk.LiveAnimator`.
    idle : bool
        Move the face while nobody of it speaks, by the sound of the user if the transport gives it.

    Attributes
    ----------
    face : AgentFace
        `set` of it changes emotion and other fields.
    names : tuple of str
        Controls, in the order of the columns.
    """

    def __init__(
        self,
        model: str | Path = "live",
        emotion: Emotion = "neutral",
        *,
        idle: bool = True,
        **fields: Any,
    ) -> None:
        super().__init__()
        self.face = AgentFace(model, emotion, **fields)
        self.names, self._moves = self.face.names, idle
        self._idle_task: asyncio.Task[None] | None = None

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Handle sound and interruptions; all other frames are passed on."""
        await super().process_frame(frame, direction)
        if isinstance(frame, TTSAudioRawFrame) and direction == FrameDirection.DOWNSTREAM:
            arguments = frame.audio, frame.sample_rate, frame.num_channels
            await self._push(await asyncio.to_thread(self.face.speak, *arguments), frame)
            return
        if isinstance(frame, TTSStoppedFrame) and direction == FrameDirection.DOWNSTREAM:
            await self._push(await asyncio.to_thread(self.face.end))
        elif isinstance(frame, InputAudioRawFrame):
            self.face.listen(frame.audio, frame.sample_rate, frame.num_channels)
        elif isinstance(frame, (EndFrame, CancelFrame)):
            await self._stop()
        await self.push_frame(frame, direction)
        if isinstance(frame, StartFrame) and self._moves:
            self._idle_task = self.create_task(self._idle())
        elif isinstance(frame, InterruptionFrame):
            await self._push(await asyncio.to_thread(self.face.interrupt), interruptible=False)

    async def cleanup(self) -> None:
        """Stop moving."""
        await self._stop()
        await super().cleanup()

    async def _stop(self) -> None:
        if self._idle_task is not None:
            task, self._idle_task = self._idle_task, None
            await self.cancel_task(task)

    async def _idle(self) -> None:
        while True:
            await asyncio.sleep(IDLE_SECONDS)
            await self._push(await asyncio.to_thread(self.face.idle))

    async def _push(
        self,
        pieces: list[Piece],
        like: TTSAudioRawFrame | None = None,
        *,
        interruptible: bool = True,
    ) -> None:
        """Push curves, and the sound of their time after them."""
        if like is not None:
            self._rate, self._context = like.sample_rate, like.context_id
        for piece in pieces:
            curves = CurvesFrame(piece.first, piece.curves, piece.head)
            curves.interruptible = interruptible
            await self.push_frame(curves)
            if piece.sound:
                sound = TTSAudioRawFrame(piece.sound, self._rate, 1, context_id=self._context)
                await self.push_frame(sound)
