"""The one writer and the one reader of models of every kind, without pickle.

What a folder holds is listed in `deitalk.models.folder`; `KINDS` is the table of kinds.
"""

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

import torch
import yaml
from safetensors.torch import save

from deitalk.config import (
    AnyConfig,
    CausalWhisperConfig,
    Config,
    DEITalkFeaturesConfig,
    KarrasConfig,
    MelConfig,
    ModelConfig,
    SDFAConfig,
    SDFAMelConfig,
    SDFAModelConfig,
    VocaConfig,
    Wav2VecConfig,
    WhisperConfig,
    WhisperShape,
    load_config,
)
from deitalk.config.rig_file import read_controls, rig_text
from deitalk.errors import CheckpointError
from deitalk.frontends import build_encoder
from deitalk.frontends.wav2vec import Wav2VecFrontend
from deitalk.frontends.windows import Encoder
from deitalk.installed import research
from deitalk.models.curve_model import DEITalk
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.devices import require_device
from deitalk.models.folder import (
    ENCODER,
    FORMAT_VERSION,
    RIG_FILE,
    model_folder,
    read_about,
    weight_files,
    weights_hash,
)
from deitalk.models.mesh_model import SDFA, DEITalkFeatures, MeshHead, MeshModel
from deitalk.models.mesh_weights import (
    FROZEN,
    about_mesh,
    all_numbers,
    empty_layers,
    only_moving,
    read_rates,
    read_templates,
    whole_shapes,
    write_templates,
)
from deitalk.models.weights_file import (
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
from rig.mesh import TriMesh

Model: TypeAlias = DEITalk | MeshModel
ModelT = TypeVar("ModelT", bound=DEITalk | MeshModel)
About: TypeAlias = dict[str, Any]
"""Content of ``model.json``."""
Build: TypeAlias = Callable[[], Model]

NAMES: dict[type, tuple[str, str]] = {
    DEITalk: ("a DEITalk model (curves)", "default"),
    MeshModel: ("a mesh model", "sdfa"),
    SDFA: ("an SDFA model (mesh)", "sdfa"),
    MeshHead: ("a mesh head", "mesh_head"),
}
"""Name of each class in messages, and an embedded example of it."""


def load_model(name_or_path: str | Path = "default", *, device: str = "cpu") -> Model:
    """Read a model of any kind, ready to predict.

    Parameters
    ----------
    name_or_path : str or Path
        ``default``, ``live``, ``sdfa``, ``mesh_head``, or a folder that `save_model` wrote.
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
    return _load(folder, load_config(folder / "config.yaml"), device)


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
    try:
        return model.to(torch.device(device)).eval()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise CheckpointError(f"device {device!r}: {reason}; use the device cpu") from None


def require_model(
    model: str | Path | Model, wanted: type[ModelT], *, device: str = "cpu"
) -> ModelT:
    """Return a model of one class, loaded if a name or a folder is given.

    Parameters
    ----------
    model : str, Path or loaded model
        A loaded one is put into evaluation mode and stays on its device.
    wanted : type
        `DEITalk`, `MeshModel`, `SDFA` or `MeshHead`.
    device : str
        As for `load_model`.

    Raises
    ------
    CheckpointError
        As `load_model`; or if the model is of another class.
    """
    needed, example = NAMES[wanted]
    if isinstance(model, str | Path):
        folder = model_folder(model)
        config = load_config(folder / "config.yaml")
        found = kind_of(config).model
        if not issubclass(found, wanted):
            raise CheckpointError(
                f"{model}: {NAMES[found][0]}; {needed} is needed, such as {example}"
            )
        model = _load(folder, config, device)
    if not isinstance(model, wanted):
        name, _ = NAMES.get(type(model), (f"a {type(model).__name__}", ""))
        raise CheckpointError(
            f"model {quoted(model)} is {name}; {needed} is needed: a name such as {example}, a "
            "folder, or a loaded model"
        )
    return model.eval()


def save_model(
    folder: Path,
    model: Model,
    config: AnyConfig,
    summary: Mapping[str, Any],
    *,
    half: bool = False,
    half_bases: bool = True,
    encoder_of: str | None = None,
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

    Raises
    ------
    CheckpointError
        If that encoder is another one.
    rig.errors.TargetError
        If the folder holds files that deitalk did not write, or edited ones.
    """
    weights = only_moving({name: w.detach().cpu() for name, w in model.state_dict().items()})
    weights = {
        name: (_half(value) if half or (half_bases and FROZEN in name) else value).contiguous()
        for name, value in weights.items()
    }
    kind = kind_of(config)
    about = {
        "format_version": FORMAT_VERSION,
        **kind.describe(model),
        "parameters": sum(p.numel() for p in model.parameters()),
        "training": dict(summary),
    }
    fixed = {name: weights.pop(name) for name in list(weights) if _is_fixed(name, model)}
    encoder = save({name: _half(value) for name, value in fixed.items()})
    if encoder_of is not None:
        if encoder != (model_folder(encoder_of) / ENCODER).read_bytes():
            raise CheckpointError(f"encoder_of={encoder_of!r}: the model has another encoder")
        about, fixed = about | {"encoder_of": encoder_of}, {}
    with output_folder(folder, kind="model", force=True) as beside:
        # save_file would make a file that nobody else may read.
        if fixed:
            (beside / ENCODER).write_bytes(encoder)
        (beside / "model.safetensors").write_bytes(save(weights))
        if isinstance(model, MeshModel):
            write_templates(beside, model, half=half)
        if isinstance(model, DEITalk) and isinstance(config, Config):
            config = _complete(config, model)
            if config.model.control_set == RIG_FILE:
                (beside / RIG_FILE).write_text(rig_text(model.controls))
        settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
        (beside / "config.yaml").write_text(settings)
        (beside / "model.json").write_text(json.dumps(about, indent=1) + "\n")


def _is_fixed(name: str, model: Model) -> bool:
    """Whether a weight is that of a published encoder, which did not learn."""
    if not isinstance(model, DEITalk) or not isinstance(model.config.frontend, WhisperShape):
        return False
    return name.startswith("frontend.encoder.") and model.config.frontend.learns == "nothing"


def _complete(config: Config, model: DEITalk) -> Config:
    """Configuration that needs no file outside the model folder: no checkpoint, no rig file."""
    settings = config.model
    if isinstance(model.frontend, Wav2VecFrontend):
        assert isinstance(settings.frontend, Wav2VecConfig)
        frontend = model.frontend.described(settings.frontend)
        settings = settings.model_copy(update={"frontend": frontend})
    if isinstance(settings.frontend, WhisperShape):
        whisper = settings.frontend.model_copy(update={"checkpoint": None})
        settings = settings.model_copy(update={"frontend": whisper})
    if model.controls.id != DEFAULT_ID:
        settings = settings.model_copy(update={"control_set": RIG_FILE})
    return config.model_copy(update={"model": settings})


def _half(value: torch.Tensor) -> torch.Tensor:
    return value.half() if value.is_floating_point() else value


def new_mesh_model(
    config: SDFAModelConfig,
    layers: Mapping[str, InversePCA],
    templates: Mapping[str, TriMesh],
    *,
    fps: float,
    unit_mm: float,
) -> SDFA | MeshHead:
    """Build a mesh model of new weights; parameters as for `deitalk.models.mesh_model.MeshModel`.

    The DEITalk model that a mesh head decodes is loaded.

    Raises
    ------
    CheckpointError
        If that model cannot be loaded.
    ConfigError
        If `config` needs lips that the templates lack.
    """
    check_faces(config.seal_mm, templates.values())
    encoder = new_encoder(config.frontend)
    if isinstance(encoder, DEITalkFeatures):
        return MeshHead(config, encoder, layers, templates, fps=fps, unit_mm=unit_mm)
    return SDFA(config, encoder, layers, templates, fps=fps, unit_mm=unit_mm)


def new_encoder(
    config: SDFAMelConfig | KarrasConfig | VocaConfig | DEITalkFeaturesConfig,
) -> Encoder | DEITalkFeatures:
    """Build the encoder of a mesh model; the DEITalk model that a mesh head decodes is loaded."""
    if not isinstance(config, DEITalkFeaturesConfig):
        return build_encoder(config)
    network = require_model(config.model, DEITalk)
    return DEITalkFeatures(network, weights_hash(model_folder(config.model)))


def network_class(config: ModelConfig) -> type[DEITalk]:
    """The class of a configuration's network."""
    if config.decoder != "emotalk":
        return DEITalk
    network: type[DEITalk] = research("comparison", "decoder emotalk").EmoTalk
    return network


def _read_curves(folder: Path, config: Config, about: About, shapes: Shapes) -> Build:
    named = config.model.control_set
    controls = read_controls(str(folder / named) if named == RIG_FILE else named)
    if about["control_set"] != controls.id or about["controls"] != list(controls.names):
        raise CheckpointError(
            f"{folder}: made for control set {quoted(about['control_set'])}, this deitalk drives "
            f"{controls.id!r}; train on curves of that set"
        )
    network = network_class(config.model)
    return partial(network, config.model, controls, pretrained=False, rules=config.rules)


def _read_sdfa(folder: Path, config: SDFAConfig, about: About, shapes: Shapes) -> Build:
    parts, frontend = _mesh_parts(folder, config, about), config.model.frontend
    assert not isinstance(frontend, DEITalkFeaturesConfig)
    return lambda: SDFA(config.model, build_encoder(frontend), empty_layers(shapes), **parts)


def _read_mesh_head(folder: Path, config: SDFAConfig, about: About, shapes: Shapes) -> Build:
    parts, frontend = _mesh_parts(folder, config, about), config.model.frontend
    features = new_encoder(frontend)
    assert isinstance(frontend, DEITalkFeaturesConfig) and isinstance(features, DEITalkFeatures)
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


def _about_curves(model: DEITalk) -> About:
    about: About = {"control_set": model.controls.id, "controls": list(model.controls.names)}
    return about | ({"actors": list(model.config.actors)} if model.config.actors else {})


def _about_mesh_head(model: MeshHead) -> About:
    return {**about_mesh(model), "decodes_sha256": model.encoder.fingerprint}


class Kind(NamedTuple):
    """One kind of model."""

    config: type[AnyConfig]
    frontends: tuple[type, ...]
    """Classes of its configuration, and of `model.frontend` in it."""
    model: type[Model]
    read: Callable[[Path, Any, About, Shapes], Build]
    """Folder, configuration, ``model.json`` and weight shapes to what builds the network."""
    describe: Callable[[Any], About]
    """The kind's own entries of ``model.json``."""


KINDS = (
    Kind(
        Config,
        (MelConfig, CausalWhisperConfig, Wav2VecConfig, WhisperConfig),
        DEITalk,
        _read_curves,
        _about_curves,
    ),
    Kind(SDFAConfig, (SDFAMelConfig, KarrasConfig, VocaConfig), SDFA, _read_sdfa, about_mesh),
    Kind(SDFAConfig, (DEITalkFeaturesConfig,), MeshHead, _read_mesh_head, _about_mesh_head),
)


def kind_of(config: AnyConfig) -> Kind:
    """Kind of the model that a configuration describes."""
    return next(
        kind
        for kind in KINDS
        if isinstance(config, kind.config) and isinstance(config.model.frontend, kind.frontends)
    )
