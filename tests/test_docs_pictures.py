"""Pictures of the README: their size, and the names in them."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

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


def test_architecture_names_exist_in_the_code():
    script = _script("make_architecture")
    for stage in script.STAGES.values():
        assert hasattr(importlib.import_module(stage.module), stage.name), stage
    linked = {key for arrow in script.ARROWS for key in arrow}
    assert linked == set(script.STAGES)


def test_architecture_picture_is_that_of_the_script(tmp_path, monkeypatch):
    script = _script("make_architecture")
    written = DOCS / "pictures/architecture.svg"
    drawn = tmp_path / "architecture.svg"
    monkeypatch.setattr(script, "PICTURE", drawn)
    script.main()
    assert _labels(drawn) == _labels(written)
    assert written.stat().st_size <= 150_000


def _labels(path: Path) -> list[str]:
    """Text of a picture in the order drawn; matplotlib notes it beside the outlines."""
    return re.findall(r"<!-- (.*?) -->", path.read_text())


def _script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
