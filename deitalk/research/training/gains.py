"""Fixed gains of some controls, in the last layer of a model.

A regression moves less than people do, and may reach one opening of the mouth by another share of
jaw and lips. ``python -m deitalk.research.training.gains MODEL jaw.ty=1.35 -o OUT`` multiplies the
rows of the decoder's last layer; all curves at rest stay there. With ``--encoder-of`` the model is
written without its encoder, which must be that of an embedded one.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from deitalk.config.load import load_config
from deitalk.errors import ConfigError, DeitalkError
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import EMBEDDED, model_folder, read_about


@torch.no_grad()
def scale_controls(model: DEITalk, gains: Mapping[str, float]) -> None:
    """Multiply the distance from rest of the controls whose names hold a part, in place.

    Raises
    ------
    ConfigError
        If no control holds it.
    """
    rest = torch.tensor(model.controls.rest)
    for part, gain in gains.items():
        places = [i for i, name in enumerate(model.controls.names) if part in name]
        if not places:
            raise ConfigError(f"{part!r}: in no control's name; such as jaw.ty")
        layer = model.decoder.output
        layer.weight[places] *= gain
        layer.bias[places] = rest[places] + gain * (layer.bias[places] - rest[places])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.gains")
    parser.add_argument("model", help="name or folder")
    parser.add_argument("gains", nargs="+", metavar="PART=GAIN")
    parser.add_argument("-o", "--out", type=Path, required=True, help="model folder")
    parser.add_argument("--encoder-of", choices=EMBEDDED)
    given = parser.parse_args(arguments)
    try:
        gains = {part: float(gain) for part, _, gain in (g.partition("=") for g in given.gains)}
        folder = model_folder(given.model)
        model = require_model(folder, DEITalk)
        scale_controls(model, gains)
        summary = read_about(folder)["training"] | {"gains": gains}
        config = load_config(folder / "config.yaml")
        save_model(given.out, model, config, summary, half=True, encoder_of=given.encoder_of)
    except (DeitalkError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
