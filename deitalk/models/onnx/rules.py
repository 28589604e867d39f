"""The rules after the network as a graph of their own, in the metadata of an exported model."""

import base64
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from deitalk.postprocess.tracks import rest_rows
from rig import ControlSet
from rig.arrays import Float32

WHOLE, LIVE = "curve_pass", "live_pass"
"""Entries of the metadata: of whole recordings, and with the look-ahead of `deitalk.live`."""
INPUTS = ("neutral", "emotional", "voice", "shown", "gain", "ruled", "state")
OUTPUTS = ("finished", "finished_neutral", "outside", "next_state")


class OnnxPass:
    """The rules in ONNX Runtime: a `deitalk.models.protocol.CurveRules`.

    Parameters
    ----------
    entry : str
        JSON of `behind`, `ahead`, and the `graph` in base64.
    controls : ControlSet
        Of the model.
    session : callable
        Makes a session of ONNX Runtime from the bytes of a graph.
    """

    def __init__(self, entry: str, controls: ControlSet, session: Any) -> None:
        about: Mapping[str, Any] = json.loads(entry)
        self.behind, self.ahead = int(about["behind"]), int(about["ahead"])
        self.before = rest_rows(controls.rest, self.behind + self.ahead)
        self._session = session(base64.b64decode(about["graph"], validate=True))

    def first(self, batch: int) -> Float32:
        """State before the first frame."""
        return np.repeat(self.before[None], batch, axis=0)

    def __call__(self, *arrays: Float32) -> tuple[Float32, Float32, Float32, Float32]:
        """Finish the next frames; see `deitalk.postprocess.curve_pass.CurvePass.forward`."""
        curves, neutral, outside, state = self._session.run(
            None, dict(zip(INPUTS, arrays, strict=True))
        )
        return curves, neutral, outside, state
