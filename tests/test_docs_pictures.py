"""Pictures of the README: their size, and the names in them."""

from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parents[1] / "docs"


def test_moving_picture_is_short_smooth_and_small():
    path = DOCS / "pictures/talking.webp"
    durations = []
    with Image.open(path) as picture:
        for k in range(picture.n_frames):
            picture.seek(k)
            picture.load()
            durations.append(picture.info["duration"])  # milliseconds
    assert path.stat().st_size <= 3_000_000
    assert 4_000 <= sum(durations) <= 6_500
    assert max(durations) <= 1000 / 12
