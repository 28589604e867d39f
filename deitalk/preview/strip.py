"""The strip under the faces: waveform, emotion, intensity, key curves, playhead and time."""

from itertools import pairwise

import numpy as np

from deitalk.preview.source import PreviewSource
from rig.arrays import Float32
from rig.emotions import COLORS
from rig.face.render.picture import Picture, text_width, write_text

KEY_CURVES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("jaw open", ("CTRL_C_jaw.ty",)),
    ("lips together", tuple(f"CTRL_{s}_mouth_lipsTogether{v}.ty" for s in "LR" for v in "UD")),
    ("round lips", tuple(f"CTRL_{s}_mouth_{k}{v}.ty" for s in "LR" for v in "UD"
                         for k in ("funnel", "purse"))),
    ("smile", tuple(f"CTRL_{s}_mouth_cornerPull.ty" for s in "LR")),
    ("brow down", tuple(f"CTRL_{s}_brow_down.ty" for s in "LR")),
    ("blink", tuple(f"CTRL_{s}_eye_blink.ty" for s in "LR")),
)  # fmt: skip
"""Six lanes; each shows the maximum of its controls."""

CURVE_COLORS = (
    (240, 170, 90),
    (120, 200, 160),
    (120, 170, 240),
    (245, 200, 80),
    (226, 96, 84),
    (180, 150, 230),
)
_BACK, _LANE, _TEXT = (22, 24, 28), (34, 37, 43), (205, 210, 218)
_MARGIN = 108


class Panel:
    """Strip of lanes, drawn once, with a playhead drawn per frame.

    Parameters
    ----------
    source : PreviewSource
    size : (int, int)
        Width and height, pixels.
    """

    def __init__(self, source: PreviewSource, size: tuple[int, int]) -> None:
        self._source = source
        self._size = size
        self._seconds = max(source.curves.duration, 1 / source.curves.fps)
        # Name, top and height of every lane.
        height = self._size[1]
        plan = [("sound", 0.24), ("emotion", 0.08), ("intensity", 0.14)]
        plan += [(name, 0.54 / len(KEY_CURVES)) for name, _ in KEY_CURVES]
        lanes, top = [], 6.0
        for name, share in plan:
            tall = share * (height - 12)
            lanes.append((name, round(top), round(tall) - 3))
            top += tall
        self._lanes = lanes
        self._picture = self._draw()

    def at(self, frame: int) -> Picture:
        """The strip (height, width, 3) with the playhead at `frame`."""
        seconds = frame / self._source.curves.fps
        picture = self._picture.copy()
        column = int(_MARGIN + seconds / self._seconds * (self._size[0] - _MARGIN - 12))
        picture[:, column : column + 2] = (250, 250, 250)
        return picture

    def time_code(self, frame: int) -> str:
        """Minutes, seconds, frame of the second, and frame number."""
        fps = self._source.curves.fps
        whole, rest = divmod(frame / fps, 60)
        return f"{int(whole):02d}:{rest:06.3f}  frame {frame}  {fps:.6g} fps"

    def _draw(self) -> Picture:
        width, height = self._size
        picture = np.empty((height, width, 3), np.uint8)
        picture[:] = _BACK
        left, right = _MARGIN, width - 12
        for name, top, tall in self._lanes:
            lane = picture[top : top + tall, left:right]
            lane[:] = _LANE
            self._fill(name, lane)
        for name, top, tall in self._lanes:
            picture = write_text(picture, name, (8, top + tall // 2 - 4), height=9, color=_TEXT)
        return picture

    def _fill(self, name: str, lane: Picture) -> None:
        curves = self._source.curves
        if name == "sound":
            _draw_sound(lane, self._source, self._seconds)
        elif name == "emotion":
            # Colour of every frame's emotions, mixed by their weights.
            emotion = curves.emotion
            if emotion is not None:
                frames = np.linspace(0, len(emotion) - 1, lane.shape[1]).round().astype(int)
                weight = emotion[frames] / np.maximum(emotion[frames].sum(1, keepdims=True), 1e-6)
                lane[:] = (
                    weight @ np.array([[*bytes.fromhex(color[1:])] for color in COLORS.values()])
                ).astype(np.uint8)[None]
        elif name == "intensity":
            if curves.intensity is not None:
                _draw_curve(lane, curves.intensity / max(1.0, float(curves.intensity.max())),
                            (250, 250, 250))  # fmt: skip
        else:
            place = [key for key, _ in KEY_CURVES].index(name)
            controls = KEY_CURVES[place][1]
            values = np.max([np.maximum(curves[c], 0) for c in controls], axis=0)
            _draw_curve(lane, values, CURVE_COLORS[place])


def _draw_sound(lane: Picture, source: PreviewSource, seconds: float) -> None:
    """Smallest and largest sample of every column."""
    tall, width = lane.shape[:2]
    if not source.sample_rate:
        return
    edges = np.linspace(0, seconds * source.sample_rate, width + 1).astype(int)
    loudest = max(float(np.abs(source.samples).max(initial=0.0)), 1e-4)
    for x, (a, b) in enumerate(pairwise(edges)):
        part = source.samples[a : max(b, a + 1)]
        if len(part):
            low, high = (0.5 - 0.48 * part.max() / loudest, 0.5 - 0.48 * part.min() / loudest)
            lane[int(low * tall) : int(high * tall) + 1, x] = (110, 160, 200)


def _draw_curve(lane: Picture, values: Float32, color: tuple[int, int, int]) -> None:
    """A filled curve of values 0..1."""
    tall, width = lane.shape[:2]
    frames = np.linspace(0, len(values) - 1, width)
    level = np.interp(frames, np.arange(len(values)), np.clip(values, 0, 1))
    top = ((1 - level) * (tall - 2)).astype(int)
    rows = np.arange(tall)[:, None]
    lane[:] = np.where((rows > top)[..., None], lane * 0.55 + 0.45 * np.array(color) * 0.6, lane)
    line = np.abs(rows - top) <= 1
    lane[line] = color


def label(picture: Picture, text: str, place: tuple[int, int], height: int = 11) -> None:
    """Write `text` into `picture` on a dark plate, so that it can be read over a face."""
    x, y = place
    plate = picture[y - 4 : y + height + 4, x - 6 : x + text_width(text, height) + 4]
    plate[:] = write_text((plate * 0.35).astype(np.uint8), text, (6, 4), height=height)
