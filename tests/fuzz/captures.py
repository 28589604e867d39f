"""Readers of captured takes to fuzz: tables of any rig, maps, labels, whole captures."""

import json
from pathlib import Path

import numpy as np

from .mutate import mutated, mutated_json, mutated_npz
from .readers_types import Reader, Seed


def _table_seeds(folder: Path) -> list[Seed]:
    rows = [[0.0, 0.1, 0.2], [0.3, 0.4, 0.5], [0.6, 0.7, 0.8]]
    names = ["jawOpen", "mouthClose", "jawLeft"]
    lines = [f"{i / 30},{','.join(map(str, row))}" for i, row in enumerate(rows)]
    frames = [{"time": i / 30, "blendShapes": dict(zip(names, row, strict=True))}
              for i, row in enumerate(rows)]  # fmt: skip
    np.savez(folder / "c.npz", names=names, values=np.array(rows), fps=30.0)
    listed = {
        "names": names,
        "frames": [{"time": i / 30, "weights": r} for i, r in enumerate(rows)],
    }
    results = [
        {"timestamp": 33 * i, "blendshapes": [
            {"categoryName": n, "score": x} for n, x in zip(names, row, strict=True)]}
        for i, row in enumerate(rows)
    ]  # fmt: skip
    zeros = ",".join("0" * 10)
    keys = [f"k,{33 * i},{zeros},{','.join(map(str, row))}" for i, row in enumerate(rows)]
    face_cap = "\n".join(['info,"a"', f"bs,{','.join(names)}", *keys])
    codes = [
        f"00:00:00:{58 + i:02d}.000,3,{','.join(map(str, row))}" for i, row in enumerate(rows[:2])
    ]
    codes += [f"00:00:01:{i:02d}.000;0" + ";" * 3 for i in range(2)]
    live_link = "\n".join([f"Timecode,BlendshapeCount,{','.join(names)}", *codes]).replace(",", ";")
    sheet = f"time;{';'.join(names)}\n" + "\n".join(lines).replace(",", ";").replace(".", ",")
    return [
        Seed("c.json", json.dumps(results).encode(), mutated_json),
        Seed("c.json", json.dumps([r["blendshapes"] for r in results]).encode(), mutated_json),
        Seed("c.txt", face_cap.encode(), mutated),
        Seed("c.csv", live_link.encode(), mutated),
        Seed("c.csv", f"sep=;\n{sheet}\n;;;\n".encode(), mutated),
        Seed("c.csv", sheet.encode("utf-16"), mutated),
        Seed("c.tsv", sheet.replace(";", "\t").encode(), mutated),
        Seed("c.csv", f"time,{','.join(names)}\n{chr(10).join(lines)}\n".encode(), mutated),
        Seed("c.json", json.dumps(frames).encode(), mutated_json),
        Seed("c.json", json.dumps(listed).encode(), mutated_json),
        Seed("c.json", json.dumps({"facsNames": names, "weightMat": rows, "exportFps": 30}).encode(),
             mutated_json),
        Seed("c.npz", (folder / "c.npz").read_bytes(), mutated_npz),
    ]  # fmt: skip


def _read_table(path: Path) -> object:
    from contextlib import suppress

    from deitalk.data.captures.take import read_capture
    from rig import read_curves
    from rig.errors import UserError

    try:
        return read_capture(path, fps=30)
    finally:
        with suppress(UserError):  # the other door
            read_curves(path, fps=30)


def _map_seeds(folder: Path) -> list[Seed]:
    text = "target,source,weight,offset\nJawOpen,a,1,0\nMouthPucker,b|c,0.5,-0.1\n"
    return [Seed("map.csv", text.encode(), mutated)]


def _read_map(path: Path) -> object:
    from deitalk.data.captures.columns import read_mapping

    return read_mapping(path)


def _label_seeds(folder: Path) -> list[Seed]:
    text = "take,actor,emotion,style,voice,split\na,anna,joy,soft,sad,test\n"
    return [Seed("labels.csv", text.encode(), mutated)]


def _read_labels(path: Path) -> object:
    from deitalk.data.captures.labels import Labelling
    from deitalk.data.captures.sources import Source

    return Labelling(table=path).of(Source(path.with_name("a.csv"), "a"))


def capture_readers() -> dict[str, Reader]:
    """Readers by name."""
    return {
        "capture": Reader(_table_seeds, _read_table),
        "capture-map": Reader(_map_seeds, _read_map),
        "capture-labels": Reader(_label_seeds, _read_labels),
    }
