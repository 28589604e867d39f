"""Outputs of the embedded models on recordings, for comparison after a restructuring.

::

    python -m tests.reference write before.npz       # before the first move
    python -m tests.reference compare before.npz     # after every step; exit code 1 if they differ

Curves are compared to 1e-5 of each control's range, vertices to 1e-5 of the head's size; a third
argument is another tolerance. Recordings of ``../shared`` are left out where it is absent.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deitalk import animate
from deitalk.audio.load import load_audio
from deitalk.live.animator import LiveAnimator
from deitalk.pipeline.mesh import animate_mesh
from rig import default_controls

ROOT = Path(__file__).parents[1]
SAMPLES = {name: ROOT / f"docs/samples/{name}.flac" for name in ("promise", "amiable")}
DATA = ROOT.parent / "shared/data"
SHARED = {
    "reader": DATA / "speech/librispeech/422-122949-0013.mp3",
    "short": DATA / "speech/librispeech/1988-147956-0001.mp3",
    "anger": DATA / "emotion/clips/1008_TIE_ANG_XX.opus",
    "disgust": DATA / "emotion/clips/1065_IEO_DIS_HI.opus",
}
TOLERANCE = 1e-5
TRACK = "time,neutral,happy,angry,fear\n0,1,0,0,0\n2,0,1,0,0\n4,.4,0,.6,0\n6,0,0,0,1\n"
CURVE = "time,intensity\n0,0.2\n2,1\n4,0.1\n20,0.7\n"
WORDS = (
    "Maybe you believe me. But mother, Bob promised everybody a piece of that perfect apple pie!"
)
ACTINGS: dict[str, dict[str, Any]] = {
    "happy": {"emotion": "happy"},
    "neutral": {"emotion": "neutral"},
    "angry 1.5": {"emotion": "angry", "intensity": 1.5},
    "sad 0": {"emotion": "sad", "intensity": 0.0},
    "contempt": {"emotion": "contempt", "life": "off"},
    "track": {"emotion": TRACK},
    "curve": {"emotion": "surprised", "intensity_curve": CURVE},
    "gain": {"emotion": "fear", "gain": {"CTRL_C_jaw.ty": 1.4}, "life": "brows=.5,head=1.2"},
    "listen": {"emotion": "calm", "listen": 4.0, "look_at": "10,-5"},
    "words": {"emotion": "happy", "words": WORDS},
    "no rules": {"emotion": "happy", "rules": False},
}
LIVE: dict[str, dict[str, Any]] = {
    "happy": {"emotion": "happy"},
    "angry 1.5": {"emotion": "angry", "intensity": 1.5},
    "disgust off": {"emotion": "disgust", "life": "off"},
    "no rules": {"emotion": "happy", "rules": False},
}


def outputs() -> Iterator[tuple[str, np.ndarray]]:
    """Curves (T, 185), intensity (T,) and head (T, 6) of curve models, vertices (T, V, 3)."""
    recordings = SAMPLES | {name: path for name, path in SHARED.items() if path.is_file()}
    for name, path in recordings.items():
        own = () if name in SAMPLES else ("words", "listen", "gain", "no rules")
        for acting in (one for one in ACTINGS if one not in own):
            yield from whole(f"{name}/default/{acting}", path, **ACTINGS[acting])
    for model in ("default", "live"):
        for backend in ("torch", "onnx"):
            for acting in ("happy", "track", "words", "no rules"):
                fields = ACTINGS[acting] | {"model": model, "backend": backend}
                yield from whole(f"{model} {backend}/{acting}", SAMPLES["promise"], **fields)
    yield from live("torch", recordings)
    yield from live("onnx", {name: recordings[name] for name in ("promise", "amiable")})
    for model in ("sdfa", "mesh_head", "default"):
        emotion = "neutral" if model == "sdfa" else "angry"
        mesh = animate_mesh(SAMPLES["promise"], emotion, model=model)
        yield f"{model}/{emotion}/vertices", mesh.vertices[::5].astype(np.float32)


def whole(name: str, path: Path, **fields: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Outputs of a take."""
    performance = animate(path, **fields)
    yield f"{name}/curves", performance.curves.values
    yield f"{name}/neutral", performance.neutral.values
    yield f"{name}/intensity", performance.predicted
    if performance.curves.head is not None:
        yield f"{name}/head", performance.curves.head


def live(backend: str, recordings: dict[str, Path]) -> Iterator[tuple[str, np.ndarray]]:
    """Curves of voices that have not ended."""
    for name, path in recordings.items():
        for acting, fields in LIVE.items():
            yield f"{backend} live/{name}/{acting}", streamed(path, backend, **fields)
    yield f"{backend} live/streams", streams([*recordings.values()][:3], backend)


def streamed(path: Path, backend: str, **fields: Any) -> np.ndarray:
    """Curves of a voice that comes in pieces of 0.1 s."""
    sound, animator = load_audio(path).waveform, LiveAnimator("live", backend=backend, **fields)
    pieces = [animator.feed(sound[at : at + 1600]) for at in range(0, len(sound), 1600)]
    return np.concatenate([*pieces, animator.finish()])


def streams(paths: list[Path], backend: str) -> np.ndarray:
    """Curves of voices side by side, whose acting changes, one after the other."""
    sounds = [load_audio(path).waveform for path in paths]
    animator = LiveAnimator("live", "sad", streams=len(sounds), backend=backend)
    found: list[list[np.ndarray]] = [[] for _ in sounds]
    for k, at in enumerate(range(0, max(map(len, sounds)), 2500)):
        if k == 10:
            animator.set(stream=0, emotion="angry", intensity=1.4, look_at=(12, 3))
        if k == 20:
            animator.set(stream=1, rules=False, gain={"CTRL_C_jaw.ty": 0.5})
        rows = animator.feed([sound[at : at + 2500] for sound in sounds])
        for parts, row in zip(found, rows, strict=True):
            parts.append(row)
    for parts, row in zip(found, animator.finish(), strict=True):
        parts.append(row)
    return np.concatenate([np.concatenate(parts) for parts in found])


def difference(before: np.ndarray, after: np.ndarray) -> float:
    """Largest difference as a share of the range (curves) or of the head's size (vertices)."""
    if before.shape != after.shape:
        return np.inf
    controls = default_controls()
    scale: np.ndarray | float = 1.0
    if before.ndim == 2 and before.shape[1] == len(controls):
        scale = controls.maximum - controls.minimum
    elif before.ndim == 2:
        scale = 90.0  # degrees of the head
    elif before.ndim == 3:
        scale = float(np.ptp(before[0], axis=0).max())
    return float(np.abs((after - before) / scale).max(initial=0))


def main(verb: str, path: str, tolerance: str = str(TOLERANCE)) -> int:
    """Write or compare; the exit code is 1 if outputs differ."""
    if verb == "write":
        np.savez_compressed(path, **dict(outputs()))  # type: ignore[arg-type]
        return 0
    worst = {}
    with np.load(path) as stored:
        for name, now in outputs():
            if name not in stored:
                continue
            worst[name] = difference(stored[name], now)
            sys.stdout.write(f"{name:40} {worst[name]:.2e}\n")
    return int(max(worst.values()) > float(tolerance))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
