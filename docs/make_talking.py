"""Write docs/pictures/talking.webp, the README's moving picture: ``make pictures CREMA=clips.csv``.

Four actors of CREMA-D (Cao et al. 2014, of no test split here) say one sentence twice, with low and
with high intensity, on four embedded heads. Below each face: the sound, and the intensity that is
predicted from it.
"""

import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from deitalk import animate
from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.preview.strip import label
from deitalk.research.evaluation.strength_clips import ACTORS, read_strength_clips
from rig import RigCurves
from rig.emotions import COLORS
from rig.face import build_head
from rig.face.accents import accents
from rig.face.head_pose import neck_share, turned
from rig.face.render import View
from rig.face.render.picture import Picture, text_width
from rig.face.render.software import Renderer

PICTURE = Path(__file__).parent / "pictures/talking.webp"
SENTENCE, LEVELS = "IEO", ("LO", "HI")
CAST = {
    "happy": ("1056", "HAP", "Ada"), "angry": ("1051", "ANG", "Bruno"),
    "sad": ("1033", "SAD", "Chidi"), "fear": ("1047", "FEA", "Kaya"),
}  # fmt: skip
"""Actor, name of the emotion in the table, and head, of each emotion."""
SECONDS, GAP_SECONDS = 5.0, 0.4
VIEW = View((0, -2.6, 3), (9, -1.9, 61), 25.5)
FACE, STRIP_HEIGHT = (215, 256), 72
"""Width and height of a face, and height of the strip, pixels."""
STEP = 2
"""Rig frames (30 Hz) to a picture: 15 pictures a second."""
BACK, SOUND = (30, 33, 39), (96, 125, 150)


def main(table: Path) -> None:
    """Animate the recordings, draw every second frame and write the animation."""
    clips = read_strength_clips(table, ACTORS)
    columns = []
    for emotion, (actor, name, head) in CAST.items():
        found = {c.level: c.path for c in clips if (c.speaker, c.emotion) == (actor, name)
                 and c.path.stem.split("_")[1] == SENTENCE}  # fmt: skip
        sound = _joined([found[level] for level in LEVELS])
        take = animate(sound, emotion, sample_rate=SAMPLE_RATE)
        strip = _strip(sound, take.curves.intensity, bytes.fromhex(COLORS[emotion][1:]))
        columns.append(list(_column(take.curves, emotion, head, strip)))
    frames = range(len(columns[0]))
    pictures = [Image.fromarray(np.hstack(rows)) for rows in zip(*columns, strict=True)]
    pictures[0].save(
        PICTURE, save_all=True, append_images=pictures[1:], loop=0, quality=36, method=4,
        duration=[round(STEP * (k + 1) / 0.03) - round(STEP * k / 0.03) for k in frames],
    )  # fmt: skip


def _joined(paths: list[Path]) -> np.ndarray:
    """Sound of recordings at their own gain, with silence between and after them."""
    gap = np.zeros(round(GAP_SECONDS * SAMPLE_RATE), np.float32)
    parts = [part for path in paths for part in (load_audio(path).waveform, gap)]
    sound = np.concatenate(parts)
    return np.pad(sound, (0, round(SECONDS * SAMPLE_RATE) - len(sound)))


def _column(curves: RigCurves, emotion: str, name: str, strip: Picture) -> Iterator[Picture]:
    """A picture (height, width, 3) of a take for every second frame, over its strip."""
    head = build_head(name)
    renderer = Renderer(head.mesh, FACE, VIEW, many=True)
    values = curves.values[::STEP]
    poses = head.pose(values)
    if curves.head is not None:
        poses = turned(poses, curves.head[::STEP], neck_share(head.mesh.vertices))
    for k, (pose, accent) in enumerate(zip(poses, accents(head, values, poses), strict=True)):
        face, lower = renderer.render(pose, accents=accent), strip.copy()
        label(face, emotion, ((FACE[0] - text_width(emotion)) // 2, FACE[1] - 22))
        column = int(k / len(values) * FACE[0])
        lower[:, column : column + 2] = 255
        yield np.vstack([face, lower])


def _strip(waveform: np.ndarray, intensity: np.ndarray, color: bytes) -> Picture:
    """The waveform in grey with the intensity (from 0 at the lower edge to 1, or what is above)."""
    width, height = FACE[0], STRIP_HEIGHT
    strip = np.empty((height, width, 3), np.uint8)
    strip[:] = BACK
    strip[:, -1] = 0
    rows = np.arange(height)[:, None]
    edges = np.linspace(0, len(waveform), width + 1).astype(int)
    parts = [waveform[a:b] for a, b in pairwise(edges)]
    peak = np.abs(waveform).max() * 2.2
    low, high = (
        height * (0.5 - np.array([f(part) for part in parts]) / peak) for f in (np.max, np.min)
    )
    strip[(rows >= low) & (rows <= high)] = SOUND
    at = np.linspace(0, len(intensity) - 1, width)
    share = np.interp(at, range(len(intensity)), intensity) / max(1, intensity.max())
    line = (height - 6) * (1 - share) + 3
    steep = 1.2 + np.abs(np.gradient(line)) / 2
    strip[np.abs(rows - line) <= steep] = list(color)
    return strip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
