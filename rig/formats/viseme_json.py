"""The 15 Oculus visemes over time as JSON, schema ``deitalk.visemes/1``."""

import json
from pathlib import Path

from rig.conversion.visemes import OCULUS, names, weights
from rig.curves import RigCurves
from rig.formats.decimal_text import Block, rows

SCHEMA = "deitalk.visemes/1"
DECIMALS = 4


def write(path: Path, curves: RigCurves) -> None:
    """Write one row of weights per frame; each row sums to 1."""
    head = {"schema": SCHEMA, "fps": curves.fps, "n_frames": len(curves), "names": names(OCULUS)}
    with path.open("wb") as stream:
        stream.write(json.dumps(head, indent=1)[:-2].encode() + b',\n "values": [\n')
        last = b""
        for text in rows([Block(weights(curves), DECIMALS)], before=b"  [", after=b"],\n"):
            stream.write(last + text[:-2])
            last = text[-2:]
        stream.write(b"\n ]\n}\n")
