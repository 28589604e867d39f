"""Contents of a folder: complete files, comparable with those of another run."""

import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

MANIFEST = ".deitalk-manifest.json"
CHANGING = ("written", "timings_seconds")
"""Keys of JSON files that differ between two equal runs."""


def hidden(folder: Path) -> list[str]:
    """Files and folders with hidden names, but for manifests."""
    found = [path for path in folder.rglob(".*") if path.name != MANIFEST]
    return sorted(str(path.relative_to(folder)) for path in found)


def files(folder: Path) -> list[Path]:
    """Files under final names, relative to the folder."""
    paths = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return sorted(p for p in paths if not any(part.startswith(".") for part in p.parts))


def check_whole(folder: Path) -> None:
    """Read every file to its end.

    Raises
    ------
    AssertionError
        If one is cut, damaged or empty.
    """
    for name in files(folder):
        path = folder / name
        try:
            data = path.read_bytes()
            READERS.get(path.suffix, _not_empty)(data)
        except Exception as error:
            raise AssertionError(f"{name} is half-written: {error!r}") from error


def contents(folder: Path) -> dict[str, object]:
    """Values of all files; equal for two equal runs."""
    found: dict[str, object] = {}
    for name in files(folder):
        data = (folder / name).read_bytes()
        if name.suffix == ".json":
            found[str(name)] = _lasting(json.loads(data))
        elif name.suffix in (".pt", ".mp4", ".html"):  # with times or random names
            found[str(name)] = READERS[name.suffix](data)
        else:
            found[str(name)] = hashlib.sha256(data).hexdigest()
    return found


def _lasting(tree: object) -> object:
    if isinstance(tree, dict):
        return {key: _lasting(value) for key, value in tree.items() if key not in CHANGING}
    return [_lasting(value) for value in tree] if isinstance(tree, list) else tree


def _not_empty(data: bytes) -> None:
    assert data


def _table(data: bytes) -> None:
    text = data.decode()
    assert text.endswith("\n")
    rows = [line.count(",") for line in text.splitlines() if '"' not in line]
    assert len(set(rows)) <= 1, "rows of several lengths"


def _arrays(data: bytes) -> None:
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        for name in stored.files:
            assert stored[name].size >= 0


def _sound(data: bytes) -> None:
    import soundfile

    with soundfile.SoundFile(io.BytesIO(data)) as file:
        assert len(file.read()) == file.frames > 0


def _picture(data: bytes) -> None:
    from matplotlib.image import imread

    assert imread(io.BytesIO(data), format="png").size


def _video(data: bytes) -> tuple[int, int]:
    import av

    with av.open(io.BytesIO(data)) as container:
        frames = sum(1 for _ in container.decode(video=0))
    with av.open(io.BytesIO(data)) as container:
        sound = sum(frame.samples for frame in container.decode(audio=0))
    assert frames and sound
    return frames, sound


def _page(data: bytes) -> int:
    assert data.rstrip().endswith(b"</html>")
    return len(data)


def _settings(data: bytes) -> None:
    import yaml

    assert isinstance(yaml.safe_load(data), dict)


def _weights(data: bytes) -> None:
    from safetensors.torch import load

    assert load(data)


def _state(data: bytes) -> str:
    import torch

    state = torch.load(io.BytesIO(data), weights_only=True)
    return hashlib.sha256(repr(_numbers(state)).encode()).hexdigest()


def _numbers(tree: object) -> object:
    import torch

    if isinstance(tree, torch.Tensor):
        return hashlib.sha256(tree.contiguous().numpy().tobytes()).hexdigest()
    if isinstance(tree, dict):
        return [(str(key), _numbers(value)) for key, value in tree.items()]
    return [_numbers(value) for value in tree] if isinstance(tree, list | tuple) else tree


READERS: dict[str, Callable[[bytes], object]] = {
    ".csv": _table, ".json": json.loads, ".npz": _arrays, ".wav": _sound, ".flac": _sound,
    ".png": _picture, ".mp4": _video, ".html": _page, ".yaml": _settings,
    ".safetensors": _weights, ".pt": _state,
}  # fmt: skip
