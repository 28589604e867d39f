"""The one writer and the one reader of models of every kind, without pickle; copies for the hub.

What a folder holds is listed in `deitalk.models.folder`; `KINDS` is the table of kinds.
"""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import torch
from safetensors.torch import save

from deitalk.config.curves import Config, ModelConfig
from deitalk.config.frontends import DEITalkFeaturesConfig, SDFAMelConfig
from deitalk.config.load import AnyConfig, load_model_config, model_text
from deitalk.config.mesh import SDFAConfig
from deitalk.config.rig_file import read_controls, rig_text
from deitalk.errors import CheckpointError, MissingError
from deitalk.frontends import build_encoder
from deitalk.frontends.base import Encoder
from deitalk.installed import imported
from deitalk.models.curve_model import DEITalk
from deitalk.models.device import require_device
from deitalk.models.folder import (
    ENCODER,
    FORMAT_VERSION,
    GRAPH,
    READOUTS,
    RIG_FILE,
    model_folder,
    read_about,
    weight_files,
    weights_hash,
)
from deitalk.models.mesh_folder import (
    FROZEN,
    all_numbers,
    empty_layers,
    only_moving,
    read_rates,
    read_templates,
    whole_shapes,
    write_templates,
)
from deitalk.models.mesh_head import MeshHead
from deitalk.models.mesh_model import SDFA, DEITalkFeatures, MeshModel
from deitalk.models.protocol import NEEDED, check_product
from deitalk.models.weight_file import (
    Shapes,
    check_fit,
    network_shapes,
    read_weights,
    without_random_numbers,
)
from deitalk.postprocess.lip_seal import check_faces
from rig.controls import DEFAULT_ID
from rig.errors import quoted, shorten
from rig.files import output_folder

Model: TypeAlias = DEITalk | MeshModel
ModelT = TypeVar("ModelT", DEITalk, MeshModel)
About: TypeAlias = dict[str, Any]
"""Content of ``model.json``."""
Build: TypeAlias = Callable[[], Model]


def load_model(name_or_path: str | Path = "default", *, device: str = "cpu") -> Model:
    """Read a model of any kind, ready to predict.

    Parameters
    ----------
    name_or_path : str or Path
        ``default``, ``live``, ``sdfa``, ``mesh_head``, a folder that `save_model` wrote, or
        ``org/name`` or ``org/name@revision`` on the Hugging Face hub.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``.

    Returns
    -------
    DEITalk, SDFA or MeshHead
        In evaluation mode.

    Raises
    ------
    CheckpointError
        If there is no such model, its files are damaged, too large or do not fit one another, or
        it belongs to another control set.
    """
    folder = model_folder(name_or_path)
    return _load(folder, load_model_config(folder), device)


def _load(folder: Path, config: AnyConfig, device: str) -> Model:
    """Read the model of a folder whose configuration is known."""
    require_device(device)
    about = read_about(folder)
    files = weight_files(folder)
    shapes = {name: shape for path in files for name, shape in whole_shapes(path).items()}
    build = kind_of(config).read(folder, config, about, shapes)
    check_fit(files[0], shapes, network_shapes(build))
    with without_random_numbers():
        model = build()
    weights = {name: value for path in files for name, value in read_weights(path).items()}
    model.load_state_dict(all_numbers(weights))  # half precision becomes float32
    if device.startswith("cuda"):
        torch.backends.cudnn.allow_tf32 = False  # else convolutions round to ten bits
    try:
        return model.to(torch.device(device)).eval()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"device {device!r}: {reason}; use the device cpu") from None


def require_model(
    model: str | Path | Model, wanted: type[ModelT], *, device: str = "cpu"
) -> ModelT:
    """Return a model of curves or of meshes, loaded if a name or a folder is given.

    Parameters
    ----------
    model : str, Path or loaded model
        A loaded one is put into evaluation mode and stays on its device.
    wanted : type
        `DEITalk` or `MeshModel`.
    device : str
        As for `load_model`.

    Raises
    ------
    CheckpointError
        As `load_model`; or if the model makes the other product.
    """
    if not isinstance(model, str | Path):
        check_product(model, wanted.product)
        return cast("ModelT", model.eval())
    folder = model_folder(model)
    config = load_model_config(folder)
    check_kind(model, config, wanted)
    return cast("ModelT", _load(folder, config, device))


def check_kind(model: str | Path, config: AnyConfig, wanted: type[ModelT]) -> None:
    """Refuse the configuration of a model that makes the other product."""
    product = kind_of(config).model.product
    if product != wanted.product:
        raise CheckpointError(f"{model}: makes {product}; {NEEDED[wanted.product]}")


def save_model(
    folder: Path,
    model: Model,
    config: AnyConfig,
    summary: Mapping[str, Any],
    *,
    half: bool = False,
    half_bases: bool = True,
    encoder_of: str | None = None,
    graph: bool = False,
) -> None:
    """Write a model folder; the files of one that was written before are replaced.

    Parameters
    ----------
    folder : Path
        Its parent must exist.
    model : DEITalk, SDFA or MeshHead
        On any device.
    config : Config or SDFAConfig
        What built the model.
    summary : mapping
        What trained it: steps, data, scores.
    half : bool
        Store all weights in float16.
    half_bases : bool
        Store the frozen bases of a mesh model in float16, the precision they were fitted in.
    encoder_of : str or None
        Embedded model whose encoder file is named instead of written, for embedded models.
    graph : bool
        Write its graph for ONNX Runtime too, if the model can have one.

    Raises
    ------
    CheckpointError
        If that encoder is another one.
    rig.errors.TargetError
        If the folder holds files that deitalk did not write, or edited ones.
    """
    weights = only_moving({name: w.detach().cpu() for name, w in model.state_dict().items()})
    readouts = {
        file: {name: weights.pop(name) for name in list(weights) if name.startswith(beginning)}
        for file, beginning in READOUTS.items()
    }
    weights = {
        name: (_half(value) if half or (half_bases and FROZEN in name) else value).contiguous()
        for name, value in weights.items()
    }
    about = {
        "format_version": FORMAT_VERSION,
        **model.about(),
        "parameters": sum(p.numel() for p in model.parameters()),
        "training": dict(summary),
    }
    fixed = {name: weights.pop(name) for name in list(weights) if model.is_fixed(name)}
    encoder = save({name: _half(value) for name, value in fixed.items()})
    if encoder_of is not None:
        if encoder != (model_folder(encoder_of) / ENCODER).read_bytes():
            raise CheckpointError(f"encoder_of={encoder_of!r}: the model has another encoder")
        about, fixed = about | {"encoder_of": encoder_of}, {}
    with output_folder(folder, kind="model", force=True) as beside:
        # save_file would make a file that nobody else may read.
        if fixed:
            (beside / ENCODER).write_bytes(encoder)
        for file, readout in readouts.items():
            if readout:
                (beside / file).write_bytes(save(readout))
        (beside / "model.safetensors").write_bytes(save(weights))
        del encoder, fixed, readouts, weights
        if model.product == "mesh":
            write_templates(beside, cast("MeshModel", model), half=half)
        else:
            config = _complete(cast("Config", config), curves := cast("DEITalk", model))
            if config.model.control_set == RIG_FILE:
                (beside / RIG_FILE).write_text(rig_text(curves.controls))
        (beside / "config.yaml").write_text(model_text(config))
        (beside / "model.json").write_text(json.dumps(about, indent=1) + "\n")
        if graph:
            from deitalk.models.onnx.engine_graph import write_graph

            with suppress(CheckpointError, MissingError):  # torch evaluates it
                write_graph(cast("DEITalk", model), beside, beside / GRAPH)


def _complete(config: Config, model: DEITalk) -> Config:
    """Configuration that needs no file outside the model folder: no checkpoint, no rig file."""
    frontend = model.frontend.described(config.model.frontend)
    changes = {"frontend": frontend, "actor_layers": model.config.actor_layers}
    settings = config.model.model_copy(update=changes)
    if model.controls.id != DEFAULT_ID:
        settings = settings.model_copy(update={"control_set": RIG_FILE})
    return config.model_copy(update={"model": settings})


def _half(value: torch.Tensor) -> torch.Tensor:
    return value.half() if value.is_floating_point() else value


def new_encoder(
    config: SDFAMelConfig | DEITalkFeaturesConfig,
) -> Encoder | DEITalkFeatures:
    """Build the encoder of a mesh model; the DEITalk model that a mesh head decodes is loaded."""
    if config.kind != "deitalk":
        return build_encoder(config)
    network = require_model(config.model, DEITalk)
    return DEITalkFeatures(network, weights_hash(model_folder(config.model)))


def network_class(config: ModelConfig) -> type[DEITalk]:
    """The class of a configuration's network."""
    network: type[DEITalk] = imported(config.network)
    return network


def _read_curves(folder: Path, config: Config, about: About, shapes: Shapes) -> Build:
    named = config.model.control_set
    controls = read_controls(str(folder / named) if named == RIG_FILE else named)
    if about["control_set"] != controls.id or about["controls"] != list(controls.names):
        raise CheckpointError(
            f"{folder}: made for control set {quoted(about['control_set'])}, this deitalk drives "
            f"{controls.id!r}; train on curves of that set"
        )
    return partial(
        network_class(config.model), config.model, controls, pretrained=False, rules=config.rules
    )


def _read_sdfa(folder: Path, config: SDFAConfig, about: About, shapes: Shapes) -> Build:
    parts, frontend = _mesh_parts(folder, config, about), config.model.frontend
    return lambda: SDFA(config.model, new_encoder(frontend), empty_layers(shapes), **parts)


def _read_mesh_head(folder: Path, config: SDFAConfig, about: About, shapes: Shapes) -> Build:
    parts, frontend = _mesh_parts(folder, config, about), config.model.frontend
    assert frontend.kind == "deitalk"
    features = cast("DEITalkFeatures", new_encoder(frontend))
    if features.fingerprint != about.get("decodes_sha256"):
        raise CheckpointError(
            f"{folder}: decodes the features of other weights than those of {frontend.model!r} "
            "now; train it again"
        )
    return lambda: MeshHead(config.model, features, empty_layers(shapes), **parts)


def _mesh_parts(folder: Path, config: SDFAConfig, about: About) -> dict[str, Any]:
    """Templates, frames per second and unit of a mesh model."""
    try:
        templates = read_templates(folder, about["speakers"])
        check_faces(config.model.seal_mm, templates.values())
        return {"templates": templates, **read_rates(about)}
    except CheckpointError:
        raise
    except (OSError, ValueError, LookupError, TypeError) as error:
        reason = shorten(" ".join(str(error).split()), 160)
        raise CheckpointError(f"{folder}: files do not fit one another ({reason})") from None


class Kind(NamedTuple):
    """One kind of model."""

    model: type[Model]
    read: Callable[[Path, Any, About, Shapes], Build]
    """Folder, configuration, ``model.json`` and weight shapes to what builds the network."""


KINDS = {
    "curves": Kind(DEITalk, _read_curves),
    "mesh": Kind(SDFA, _read_sdfa),
    "mesh_head": Kind(MeshHead, _read_mesh_head),
}


def kind_of(config: AnyConfig) -> Kind:
    """Kind of the model that a configuration describes."""
    return KINDS["mesh_head" if config.model.frontend.kind == "deitalk" else config.product]
