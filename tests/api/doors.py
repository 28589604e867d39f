"""Doors of an acting: the commands, HTTP, the mesh and live voices, and what each of them made."""

import importlib
import io
import json
import shutil
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from websockets.sync.client import connect

from api.live.messages import FRAME
from deitalk import LiveAnimator
from deitalk.live.sources import PacedSound
from rig import read_curves
from rig.face.head import Head
from rig.livelink.pace import LiveReport
from tests.api.case_files import FILES
from tests.command import ran
from tests.deitalk.batch.conftest import InProcess

SIGNAL = ("track", "channel", "raw")
SHIFT = ("delay_frames", "handles_frames")


@dataclass
class Made:
    """What a door made: curves (T, C), settings and signal of its take, how that is written."""

    values: np.ndarray
    settings: dict
    signal: dict
    written: dict


def take_of(folder: Path) -> Made:
    about = json.loads((folder / "take.json").read_text())
    signal = {name: about["source"][name] for name in SIGNAL if name in about["source"]}
    written = {name: about[name] for name in SHIFT if name in about}
    written["seconds"] = soundfile.info(folder / "audio.wav").duration
    written |= {path.name: start_of_live_link(path) for path in folder.glob("*_take_1_*.csv")}
    values = read_curves(folder / "curves.json").values
    return Made(values, about["settings"], signal, written)


def start_of_live_link(path: Path) -> str:
    """Time code of the first frame."""
    return path.read_text().splitlines()[1].split(",")[0]


def only_curves(monkeypatch):
    """Leave out the files for other programs, which take longer than all else."""
    monkeypatch.setattr("deitalk.pipeline.performance.write_exchange_files", lambda *_, **__: {})


def run(*words):
    done = ran(*[str(word) for word in words])
    return done.output


def options(fields):
    """A command line's options."""
    found = []
    for name, value in fields.items():
        flag = f"--{name.replace('_', '-')}"
        found += [f"--no-{name}"] if value == "false" else [flag, value]
    return found


def command_line(fields, tmp_path, monkeypatch, audio="line.wav"):
    run("animate", audio, "-o", f"{tmp_path}/take/", "--model", "tiny", *options(fields))
    return take_of(tmp_path / "take")


def batch_line(fields, tmp_path, monkeypatch, audio="line.wav"):
    monkeypatch.setattr("deitalk.batch.run.Workers", InProcess)
    (tmp_path / "lines").mkdir()
    (tmp_path / "lines" / "line.wav").write_bytes(Path(audio).read_bytes())
    run("batch", tmp_path / "lines", "-o", tmp_path / "out", "--model", "tiny", "--format", "take",
        *options(fields))  # fmt: skip
    return take_of(tmp_path / "out" / "line")


def manifest(fields, tmp_path, monkeypatch, audio="line.wav"):
    monkeypatch.setattr("deitalk.batch.run.Workers", InProcess)
    row = {"audio": audio, "output": "line", **fields}
    table = Path(f"manifest-{tmp_path.name}.csv")
    quoted = (f'"{cell}"' for cell in row.values())
    table.write_text(f"{','.join(row)}\n{','.join(quoted)}\n")
    run("batch", table, "-o", tmp_path / "out", "--model", "tiny", "--format", "take")
    return take_of(tmp_path / "out" / "line")


def http(fields, server, audio="line.wav"):
    return take_of(post("/v1/animations", fields | {"recording": audio}, server))


def post(path, fields, server):
    """The take that a route answers with; values that are names of files are sent as files."""
    is_file = {name: Path(value).is_file() for name, value in fields.items()}
    files = {n: (v, Path(v).read_bytes()) for n, v in fields.items() if is_file[n]}
    data = {name: value for name, value in fields.items() if not is_file[name]}
    with server.client() as client:
        answer = client.post(path, files=files, data=data | {"model": "tiny", "format": "take"})
    assert answer.status_code == 200, answer.text
    shutil.rmtree("http", ignore_errors=True)
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        archive.extractall("http")
    return Path("http")


def mesh(fields, tmp_path, monkeypatch, audio="line.wav"):
    """The curves that a mesh is posed by, and the poses of every tenth frame."""
    pose, curves = Head.pose, []
    monkeypatch.setattr(np, "savez_compressed", np.savez)  # for time

    def every_tenth(head, values):  # a table of frames; a single one is a call of its own
        if np.ndim(values) == 1:
            return pose(head, values)
        curves.append(values)
        return pose(head, values[::10])

    monkeypatch.setattr(Head, "pose", every_tenth)
    run("animate", audio, "--vertices", "-o", tmp_path / "m.npz", "--model", "tiny",
        *options(fields))  # fmt: skip
    monkeypatch.undo()
    return curves[0], np.load(tmp_path / "m.npz")["vertices"]


def live_python(fields, samples):
    """The reference of the live doors, which differ from `animate` until both have one path."""
    animator = LiveAnimator("tiny", **fields)
    return np.concatenate((animator.feed(samples), animator.finish()))


def sound():
    return soundfile.read("line.wav", dtype="float32")[0]


class Unpaced(PacedSound):
    """A recording whose blocks come at once."""

    def read(self, seconds):
        self.start = -60.0
        return super().read(seconds)


class Kept:
    """Stands for the network at the end of `deitalk live`; keeps the frames."""

    def __init__(self, *_):
        self.frames = []

    def push(self, frames, head, **_):
        self.frames.append(frames)

    def report(self):
        return LiveReport(0, 0, 0, (0.0, 0.0))

    def __getattr__(self, name):
        return lambda *_, **__: None


def live_line(fields, monkeypatch, audio="line.wav"):
    kept, command = Kept(), importlib.import_module("deitalk.cli.live")
    monkeypatch.setattr(command, "sender_of", lambda *_: kept)
    monkeypatch.setattr("deitalk.live.sources.PacedSound", Unpaced)
    run("live", audio, "--model", "tiny", *options(fields))
    return np.concatenate(kept.frames)


def websocket(fields, server):
    given = {name: FILES.get(value, value) for name, value in fields.items()}
    url = server.url.replace("http", "ws") + "/v1/live"
    with connect(url, max_size=2**24, proxy=None) as session:
        start = {"type": "start", "model": "tiny", "head": True, "encoding": "float32"}
        session.send(json.dumps(start | {"seed": "0"} | given))
        assert json.loads(session.recv(60))["type"] == "header"
        session.send(sound().astype("<f4").tobytes())
        session.send('{"type": "stop"}')
        rows = []
        while isinstance(message := session.recv(60), bytes):
            records = np.frombuffer(message, np.uint8).reshape(-1, FRAME.size + 4 * 191)
            rows.append(records[:, FRAME.size :].copy().view("<f4")[:, :185])
    assert json.loads(message)["type"] == "end", message
    return np.concatenate(rows)
