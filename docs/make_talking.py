"""Write docs/pictures/talking.webp, the README's moving picture: ``make pictures``.

The recording docs/samples/amiable.flac in four emotions on four embedded heads, at 1.5 times the
intensity predicted from the voice, which a bar beside each face shows and a line under all.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from deitalk import animate
from deitalk.preview.video import label
from rig import RigCurves
from rig.emotions import COLORS
from rig.face import build_head
from rig.face.accents import accents
from rig.face.render import View, make_renderer
from rig.face.render.shading import Picture, text_width, write_text

DOCS = Path(__file__).parent
RECORDING, PICTURE = DOCS / "samples/amiable.flac", DOCS / "pictures/talking.webp"
PEOPLE = {"happy": "female", "angry": "male", "sad": 0, "surprised": "child"}
"""Head of each emotion."""
INTENSITY, TOP = 1.5, 1.4
"""Factor, and the intensity at the upper end of the bars."""
VIEW = View((0, -2.6, 3), (9, -1.9, 61), 25.5)
FACE, STRIP_HEIGHT = (215, 256), 80
"""Width and height of a face, and height of the strip, pixels."""
STEP = 2
"""Rig frames (30 Hz) to a picture: 15 pictures a second."""
BACK, SOUND, CURVE, TEXT = (30, 33, 39), (96, 125, 150), (245, 190, 66), (225, 228, 233)


def main() -> None:
    """Animate the recording, draw every second frame and write the animation."""
    takes = [animate(RECORDING, emotion, intensity=INTENSITY) for emotion in PEOPLE]
    frames = range(0, len(takes[0].curves), STEP)
    faces = [_faces(take.curves, name) for take, name in zip(takes, PEOPLE, strict=True)]
    strip = _strip(takes[0].recording.waveform, takes[0].predicted)
    pictures = []
    for rows, frame in zip(zip(*faces, strict=True), frames, strict=True):
        lower = strip.copy()
        column = int(frame / len(takes[0].curves) * strip.shape[1])
        lower[:, column : column + 2] = 255
        pictures.append(Image.fromarray(np.vstack([np.hstack(rows), lower])))
    pictures[0].save(
        PICTURE, save_all=True, append_images=pictures[1:], loop=0, quality=38, method=4,
        duration=[round((k + STEP) / 0.03) - round(k / 0.03) for k in frames],
    )  # fmt: skip


def _faces(curves: RigCurves, emotion: str) -> list[Picture]:
    """A picture (height, width, 3) of a take's head for every second frame, with its intensity."""
    head = build_head(PEOPLE[emotion])
    renderer = make_renderer(head.mesh, size=FACE, view=VIEW, backend="software")
    values = curves.values[::STEP]
    poses = head.pose(values)
    shown = zip(poses, accents(head, values, poses), strict=True)
    pictures = [renderer.render(pose, accents=accent) for pose, accent in shown]
    renderer.close()
    color, low = bytes.fromhex(COLORS[emotion][1:]), FACE[1] - 8
    for picture, intensity in zip(pictures, curves.intensity[::STEP], strict=True):
        label(picture, emotion, ((FACE[0] - text_width(emotion)) // 2, FACE[1] - 22))
        picture[8:low, 8:14] = BACK
        picture[round(low - (low - 8) * min(intensity / TOP, 1)) : low, 8:14] = list(color)
    return pictures


def _strip(waveform: np.ndarray, intensity: np.ndarray) -> Picture:
    """The waveform in grey with the intensity (0 to 1, from the lower to the upper edge)."""
    width, height = FACE[0] * len(PEOPLE), STRIP_HEIGHT
    strip = np.empty((height, width, 3), np.uint8)
    strip[:] = BACK
    rows = np.arange(height)[:, None]
    edges = np.linspace(0, len(waveform), width + 1).astype(int)
    parts = [waveform[a:b] for a, b in pairwise(edges)]
    peak = np.abs(waveform).max() * 2.2
    low, high = (
        height * (0.5 - np.array([f(part) for part in parts]) / peak) for f in (np.max, np.min)
    )
    strip[(rows >= low) & (rows <= high)] = SOUND
    level = np.interp(np.linspace(0, len(intensity) - 1, width), range(len(intensity)), intensity)
    strip[np.abs(rows - (height - 4) * (1 - level) - 2) <= 1.2] = CURVE
    return write_text(strip, "intensity predicted from the voice", (8, 8), height=9, color=TEXT)


if __name__ == "__main__":
    main()
