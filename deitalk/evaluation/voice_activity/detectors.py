"""Detectors to compare: deitalk's, silero-vad's ONNX model and WebRTC's; the last two are optional.

Letters: S samples at 16 kHz, T rig frames at 30 Hz.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count, frame_times
from deitalk.audio.voice_activity import speech_activity
from deitalk.errors import DataError, MissingError
from rig.arrays import AnyFloat, Bool, Float32

LONGEST_GAP = 6
"""Frames (0.2 s) without speech that are bridged in the output of other packages' detectors."""
WIDENINGS = (0, 1, 2, 3)
"""Candidates of frames added before and after speech."""
SILERO_CHUNK, SILERO_CONTEXT = 512, 64  # samples
WEBRTC_CHUNK = 160  # samples, 10 ms


@dataclass(frozen=True)
class Setting:
    """Operating point of a detector."""

    mode: int = 0
    """Aggressiveness of WebRTC's detector, 0 to 3."""
    threshold: float = 0.5
    widen: int = 0
    """Frames added before and after speech."""


@dataclass(frozen=True)
class Detector:
    """A function that gives evidence for speech, and its candidate operating points."""

    name: str
    evidence: Callable[[Float32, int], Float32]
    """(waveform [shape=(S,)], mode) to evidence [shape=(T,), range 0 to 1]."""
    settings: tuple[Setting, ...] = (Setting(),)


def decide(evidence: AnyFloat, setting: Setting) -> Bool:
    """Frames of speech [shape=(T,)]: threshold, bridged gaps, no single frames, widened."""
    from scipy.ndimage import binary_closing, binary_dilation, binary_opening

    active = np.pad(np.asarray(evidence) >= setting.threshold, LONGEST_GAP + 1)
    active = binary_closing(active, np.ones(LONGEST_GAP + 1, bool))
    active = binary_opening(active, np.ones(2, bool))
    active = active[LONGEST_GAP + 1 : -LONGEST_GAP - 1]
    return binary_dilation(active, iterations=setting.widen) if setting.widen else active


def make_detector(name: str) -> Detector:
    """Detector by name: ``ours``, ``silero`` or ``webrtc``.

    Raises
    ------
    DataError
        If the name is unknown.
    MissingError
        If its package is not installed.
    """
    makers = {"ours": _ours, "silero": _silero, "webrtc": _webrtc}
    if name not in makers:
        raise DataError(f"detector {name!r} is unknown; known are {', '.join(makers)}")
    return makers[name]()


def _ours() -> Detector:
    return Detector("ours", lambda waveform, mode: speech_activity(waveform))


def _silero() -> Detector:
    """silero-vad's ONNX model, without torch; probabilities of chunks of 32 ms."""
    from importlib.util import find_spec

    spec = find_spec("silero_vad")
    try:
        import onnxruntime
    except ImportError:
        spec = None
    if spec is None or spec.origin is None:
        raise MissingError("silero needs two packages; pip install silero-vad onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    model = Path(spec.origin).parent / "data" / "silero_vad_16k_sequence.onnx"
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def evidence(waveform: Float32, mode: int) -> Float32:
        n_chunks = -(-len(waveform) // SILERO_CHUNK)
        padded = np.zeros(SILERO_CONTEXT + n_chunks * SILERO_CHUNK, np.float32)
        padded[SILERO_CONTEXT : SILERO_CONTEXT + len(waveform)] = waveform
        windows = np.lib.stride_tricks.sliding_window_view(padded, SILERO_CONTEXT + SILERO_CHUNK)
        state = np.zeros((1, 1, 128), np.float32)
        inputs = {"input": windows[::SILERO_CHUNK].copy(), "h": state, "c": state}
        (speech,) = session.run(["speech_probs"], inputs)
        centres = (np.arange(n_chunks) + 0.5) * SILERO_CHUNK / SAMPLE_RATE
        times = frame_times(frame_count(len(waveform)))
        at_frames: Float32 = np.interp(times, centres, speech.ravel()).astype(np.float32)
        return at_frames

    thresholds = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    settings = tuple(Setting(0, t, w) for t in thresholds for w in WIDENINGS)
    return Detector("silero", evidence, settings)


def _webrtc() -> Detector:
    """WebRTC's detector; the share of the 10 ms chunks within 1/60 s of a frame."""
    try:
        import webrtcvad
    except ImportError:
        raise MissingError("webrtc needs a package; pip install webrtcvad-wheels") from None

    def evidence(waveform: Float32, mode: int) -> Float32:
        detector = webrtcvad.Vad(mode)
        n_chunks = -(-len(waveform) // WEBRTC_CHUNK)
        padded = np.pad(waveform, (0, n_chunks * WEBRTC_CHUNK - len(waveform)))
        steps = (padded.clip(-1, 1) * 32767).astype("<i2").reshape(n_chunks, WEBRTC_CHUNK)
        votes = [detector.is_speech(chunk.tobytes(), SAMPLE_RATE) for chunk in steps]
        total = np.concatenate([[0], np.cumsum(votes)])
        times = frame_times(frame_count(len(waveform))) * SAMPLE_RATE / WEBRTC_CHUNK
        reach = SAMPLE_RATE / WEBRTC_CHUNK / FRAME_RATE / 2
        first = np.clip(np.round(times - reach), 0, n_chunks - 1).astype(int)
        stop = np.clip(np.round(times + reach), first + 1, n_chunks).astype(int)
        share: Float32 = ((total[stop] - total[first]) / (stop - first)).astype(np.float32)
        return share

    return Detector(
        "webrtc", evidence, tuple(Setting(m, 0.5, w) for m in range(4) for w in WIDENINGS)
    )
