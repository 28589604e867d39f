"""The stream of Audio2Face-3D's public protocol (package ``nvidia-audio2face-3d``) over gRPC.

::

    client   header, samples with emotions …, end of audio
    server   header, ARKit shapes with the sound of their time …, event at the end, status

Parameters of the face and of emotions after the first, which are of Audio2Face's own network, are
not used.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import grpc
import numpy as np
from nvidia_ace import animation_pb2 as ace
from nvidia_ace import audio_pb2, status_pb2
from nvidia_audio2face_3d import audio2face_pb2_grpc
from nvidia_audio2face_3d import messages_pb2 as a2f

from api.compute.live import MODEL
from api.errors import Problem, problem_for
from api.guard.keys import Caller, KeyRing, client_of, require
from api.live.session import QUIET_SECONDS, START_SECONDS
from api.live.stream import LiveStream
from api.service import Service
from deitalk.acting import Acting
from deitalk.audio.frames import FRAME_RATE
from deitalk.models.folder import model_folder, read_about
from rig.arrays import Float32
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.curves import HEAD, RigCurves
from rig.errors import quoted

MESSAGE_BYTES = 1 << 20
SHAPES = [name for name in arkit_controls().names if not name.endswith(("Yaw", "Pitch", "Roll"))]
"""The 52 blendshapes of ARKit."""
EMOTIONS = {
    "amazement": "surprised", "anger": "angry", "cheekiness": "happy", "disgust": "disgust",
    "fear": "fear", "grief": "sad", "joy": "happy", "pain": "sad", "sadness": "sad",
}  # fmt: skip
"""Our nearest to each of Audio2Face's emotions; ``outofbreath`` has none."""
CODES = {
    401: grpc.StatusCode.UNAUTHENTICATED,
    403: grpc.StatusCode.PERMISSION_DENIED,
    429: grpc.StatusCode.RESOURCE_EXHAUSTED,
    500: grpc.StatusCode.INTERNAL,
    503: grpc.StatusCode.UNAVAILABLE,
}


@asynccontextmanager
async def serving_grpc(service: Service) -> AsyncIterator[None]:
    """Serve the stream on the settings' ``grpc_port`` during the block."""
    settings = service.settings
    options = [("grpc.max_receive_message_length", MESSAGE_BYTES)]
    server = grpc.aio.server(options=options, maximum_concurrent_rpcs=settings.connections)
    add: Any = audio2face_pb2_grpc.add_A2FControllerServiceServicer_to_server
    add(Audio2Face(service), server)
    server.add_insecure_port(f"{settings.host}:{settings.grpc_port}")
    await server.start()
    try:
        yield
    finally:
        await server.stop(0)


class Audio2Face:
    """The service ``A2FControllerService``.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self.service, self.keys = service, KeyRing(service.settings)

    async def ProcessAudioStream(self, requests: Any, context: Any) -> AsyncIterator[Any]:
        """Animate a voice; a key is sent as metadata ``authorization: Bearer <key>``."""
        try:
            address = client_of(context.peer().partition(":")[2].rpartition(":")[0])
            caller = await self._caller(dict(context.invocation_metadata()), address)
            with (
                self.service.traffic.places.hold(caller.holder, caller.concurrent),
                self.service.live.hold(caller.holder, caller.live),
            ):
                async for message in _Voice(self.service, caller, aiter(requests)).messages():
                    yield message
            return
        except Exception as error:
            problem = problem_for(error)
        code = CODES.get(problem.status, grpc.StatusCode.INVALID_ARGUMENT)
        await context.abort(code, problem.message)

    async def _caller(self, metadata: Mapping[str, str], address: str) -> Caller:
        if self.service.is_draining:
            raise Problem(503, "the server ends; connect again", "busy")
        caller = self.keys.caller(
            metadata.get("authorization", "").removeprefix("Bearer "), address
        )
        require(caller, "live")
        await self.service.check_quota(caller)
        return caller


class _Voice:
    """One stream: its requests, and its messages."""

    def __init__(self, service: Service, caller: Caller, requests: Any) -> None:
        self.service, self.caller, self.requests = service, caller, requests
        self.sound = bytearray()
        """Samples that were not sent back."""
        self.sent = 0
        self.about = read_about(model_folder(MODEL))

    async def messages(self) -> AsyncIterator[Any]:
        header = (await self._next(START_SECONDS)).audio_stream_header
        audio, self.shapes = header.audio_header, header.blendshape_params
        # Refuse sound that is not 16-bit PCM of one channel.
        is_pcm = audio.audio_format == audio_pb2.AudioHeader.AUDIO_FORMAT_PCM
        if not is_pcm or (audio.channel_count, audio.bits_per_sample) != (1, 16):
            raise Problem(422, "send 16-bit PCM of one channel", "option_invalid")
        if not 8_000 <= audio.samples_per_second <= 192_000:
            raise Problem(
                422, f"{audio.samples_per_second} samples a second must be 8000 to 192000",
                "option_invalid",
            )  # fmt: skip
        life = replace(Acting().life, head=0.0)  # ARKit's shapes have no head
        emotion = _emotion(header.emotion_params.beginning_emotion)
        acting = Acting.of(None, life=life, emotion=emotion)
        voice, _ = await self.service.voices.open(MODEL, acting)
        self.rate = audio.samples_per_second
        longest, late = self.service.settings.live_seconds, self.service.metrics.late.observe
        self.stream = LiveStream(self.rate, False, voice, longest, late)
        reading = asyncio.create_task(self._read(acting))
        try:
            joints = ace.SkelAnimationHeader(blend_shapes=SHAPES)
            yield a2f.A2F3DAnimationDataStream(
                animation_data_stream_header=a2f.A2F3DAnimationDataStreamHeader(
                    audio_header=audio, skel_animation_header=joints
                )
            )
            while not self.stream.is_done:
                rows = [await voice.next_frames()]
                while not voice.frames.empty():  # what came meanwhile: a fit costs as much for many
                    rows.append(await voice.next_frames())
                frames = np.concatenate(rows)
                if not len(frames):
                    continue
                begin, _ = self.stream.come(frames)
                yield self._data(begin, await asyncio.to_thread(self._fitted, frames))
            event = a2f.Event(event_type=a2f.END_OF_A2F_AUDIO_PROCESSING)
            yield a2f.A2F3DAnimationDataStream(event=event)
            status = status_pb2.Status(code=status_pb2.Status.SUCCESS, message="done")
            yield a2f.A2F3DAnimationDataStream(status=status)
        finally:
            reading.cancel()
            voice.close()
            await self.service.count_live(self.caller, self.stream.seconds)

    async def _next(self, seconds: float) -> Any:
        try:
            return await asyncio.wait_for(anext(self.requests), seconds)
        except TimeoutError:
            raise Problem(400, f"no message for {seconds:g} s", "session_quiet") from None
        except StopAsyncIteration:
            raise Problem(422, "the stream ended before end_of_audio", "message_unknown") from None

    async def _read(self, acting: Acting) -> None:
        """Take requests, none while too much sound waits; an error ends the voice."""
        try:
            while not self.stream.is_whole:
                request = await self._next(QUIET_SECONDS)
                self.stream.check_length()
                if request.WhichOneof("stream_part") == "end_of_audio":
                    self.stream.finish()
                    continue
                part = request.audio_with_emotion
                if part.emotions:
                    acting = Acting.of(acting, emotion=_emotion(part.emotions[-1].emotion))
                    self.stream.change(acting)
                self.sound += part.audio_buffer
                self.stream.feed(part.audio_buffer)
                await self.stream.wait_for_room()
        except Exception as error:
            self.stream.voice.frames.put_nowait(error)

    def _fitted(self, frames: Float32) -> Float32:
        """ARKit's shapes for frames of the voice (n, C + 6), as the client wants them (n, 52)."""
        values = frames[:, : -len(HEAD)]
        curves = RigCurves(
            values, self.about["controls"], fps=FRAME_RATE, control_set=self.about["control_set"]
        )
        shapes = convert(curves, ARKIT_ID).values[:, arkit_controls().indices(SHAPES)]
        given = self.shapes
        for k, name in enumerate(SHAPES):
            factor = given.bs_weight_multipliers.get(name, 1.0)
            shapes[:, k] = factor * shapes[:, k] + given.bs_weight_offsets.get(name, 0.0)
        return shapes.clip(0, 1) if given.enable_clamping_bs_weight else shapes

    def _data(self, begin: int, shapes: Float32) -> Any:
        """Frames from number `begin` on, with the sound of their time."""
        weights = [
            ace.FloatArrayWithTimeCode(time_code=(begin + k) / FRAME_RATE, values=row)
            for k, row in enumerate(shapes)
        ]
        n_bytes = 2 * (self.stream.next_frame * self.rate // FRAME_RATE) - self.sent
        sound = bytes(self.sound if self.stream.is_done else self.sound[:n_bytes])
        del self.sound[: len(sound)]
        spoken = ace.AudioWithTimeCode(time_code=self.sent / 2 / self.rate, audio_buffer=sound)
        self.sent += len(sound)
        skeleton = ace.SkelAnimation(blend_shape_weights=weights)
        data = ace.AnimationData(skel_animation=skeleton, audio=spoken)
        return a2f.A2F3DAnimationDataStream(animation_data=data)


def _emotion(given: Mapping[str, float]) -> dict[str, float]:
    """Weights of our emotions, their sum 1 or less; neutral without any."""
    weights: dict[str, float] = {}
    for name, weight in given.items():
        if name in EMOTIONS:
            weights[EMOTIONS[name]] = weights.get(EMOTIONS[name], 0.0) + weight
        elif name != "outofbreath":
            raise Problem(
                422, f"emotion {quoted(name)} is unknown; known are {', '.join(EMOTIONS)}"
            )
    total = max(sum(weights.values()), 1.0)
    return {name: weight / total for name, weight in weights.items()} or {"neutral": 1.0}
