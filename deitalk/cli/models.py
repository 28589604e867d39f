"""`deitalk finetune` and `deitalk model`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deitalk.cli.console import bar, console, emit, emit_json, reserve_file, reserve_folder
from deitalk.cli.options import CheckedCommands
from deitalk.installed import research

if TYPE_CHECKING:
    from deitalk.cli.console import Advance
    from deitalk.config.curves import FinetuneConfig
    from deitalk.training.trainer import Progress


def shown_on(advance: "Advance") -> "Progress":
    """Return a callback that shows step, loss, and the scores of every evaluation."""

    def progress(step: int, total: int, values: dict[str, float]) -> None:
        scores = [f"{name[4:]} {v:.4g}" for name, v in values.items() if name.startswith("dev_")]
        loss = [f"loss {values['total']:.4g}"] if "total" in values else []
        rate = [f"{values['rate']:.3g} samples/s"] if "rate" in values else []
        text = ", ".join([f"step {step} of {total}", *loss, *rate, *scores])
        for phase in {"read", "encoded", "fitted"} & values.keys():
            text = f"{values[phase]:.0%} of the captures {phase}"
        advance(step / max(total, 1), text, always=bool(scores))

    return progress


# `deitalk finetune`: a model tuned on captures.


def finetune(
    data: Annotated[Path, typer.Argument(help="Dataset folder of captures (docs/dataset.md).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Run folder.")],
    base: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Model to tune: default, a folder, or org/name on the hub.",
        ),
    ] = None,
    recipe: Annotated[
        Path | None, typer.Option("--recipe", help="YAML, such as configs/finetune.yaml.")
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig", help="YAML of a rig other than the MetaHuman board; by default DATA/rig.yaml."
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(
            "--map", help="Table of the rig's curves to the board, which carries emotions to it."
        ),
    ] = None,
    part: Annotated[
        str | None, typer.Option("--tune", help="What train.steps change: head, decoder or all.")
    ] = None,
    rehearse: Annotated[
        str | None, typer.Option("--rehearse", help="Dataset folder whose speech holds the base.")
    ] = None,
    leave_out: Annotated[
        str | None, typer.Option("--leave-out", help="Take or actor to test on, not to train on.")
    ] = None,
    folds: Annotated[
        str | None, typer.Option(help="Leave out each of the takes, or actors, in turn.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="Override, such as train.steps=400.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 3 where loudness predicts as well.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run folder; begin it if it is new.")
    ] = False,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Also write OUT/tensorboard, for TensorBoard.")
    ] = False,
) -> None:
    """Tune a model on captures of an actor or of another rig; the result is OUT/best.

    OUT/report.md compares it with the model before, the mean pose and loudness on held-out clips.

    Examples
    --------
    deitalk finetune my_captures/ -o runs/anna

    deitalk finetune my_captures/ --rig my_rig.yaml -o runs/my_rig

    deitalk finetune my_captures/ --folds takes -o runs/folds
    """
    changes = {"tune.part": part, "tune.corpus": rehearse}
    with console().status("loading"):
        from deitalk.training.tuning.public import run_tuning, settings_of
        from rig.files import remove_written

        settings = settings_of(
            data,
            base=base,
            rig=rig,
            mapping=mapping,
            leave_out=leave_out,
            recipe=recipe,
            settings=changes,
            overrides=overrides or (),
        )
    if folds is not None:
        _tune_folds(settings, data, out, folds, strict, resume=resume, tensorboard=tensorboard)
        return
    options: dict[str, Any] = {"resume": resume, "tensorboard": tensorboard}
    with bar("tuning") as advance:
        tuned = run_tuning(settings, data, out, progress=shown_on(advance), **options)
    remove_written(out / "last")  # only the best is used
    _print_scores(tuned.scores)
    console().print(f"{tuned.model}: the tuned model; {out / 'report.md'}: before and after")
    console().print(f"the result is {tuned.delivered}")
    for name, takes in tuned.conventions.items():
        console().note(f"style {name}: {', '.join(takes)}, which share a convention")
    for line in tuned.warnings:
        console().note(line)
    _write_page(out)
    if strict and not tuned.beats_loudness:
        raise typer.Exit(NOT_BETTER)


NOT_BETTER = 3
"""Exit code with --strict where a tuned model is no better than a line over loudness."""


def _tune_folds(
    settings: "FinetuneConfig", data: Path, out: Path, kind: str, strict: bool, **options: bool
) -> None:
    """Leave out each take or actor in turn, and print the scores."""
    from deitalk.evaluation.comparison import beats_loudness, warnings_of

    tune_folds = research("training.folds", "finetune --folds").tune_folds
    with bar("tuning") as advance:
        result = tune_folds(settings, data, out, kind, progress=shown_on(advance), **options)
    _print_scores(result["folds"])
    console().print("means over the folds:")
    _print_scores(result["mean"])
    for line in warnings_of(result["mean"]):
        console().note(line)
    console().print(f"{out / 'folds.md'}: all scores, of each control too")
    if strict and not beats_loudness(result["mean"]):
        raise typer.Exit(NOT_BETTER)


def _print_scores(scores: dict[str, dict[str, float]]) -> None:
    for name, values in scores.items():
        text = ", ".join(
            f"{key} {values[key]:.3g}"
            for key in ("error_of_mean_pose", "mean_r", "range")
            if values.get(key) is not None
        )
        emit(f"{name}\t{text}")


def _write_page(out: Path) -> None:
    """Play a held-out clip: captured, before and after, side by side or as lines."""
    from deitalk.errors import MissingError
    from deitalk.evaluation.comparison import COMPARED
    from deitalk.preview.page import render_page
    from deitalk.preview.source import load_source

    folder, page = out / COMPARED, out / f"{COMPARED}.html"
    names = ("capture", "before", "after")
    paths = [folder / f"{name}.npz" for name in names if (folder / f"{name}.npz").is_file()]
    try:
        sounds = (folder / "audio.wav", None, None)
        takes = [load_source(*each) for each in zip(paths, sounds, strict=False)]
        render_page(takes, page, force=True)
    except MissingError as error:
        console().note(str(error))
    else:
        console().print(f"{page}: capture, before and after, side by side")


# `deitalk model`: description of a model, export of a copy, a mix of two, the hub.


app = CheckedCommands(help="Describe or export a model.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Describe or export a model."""


@app.command()
def export(
    model: Annotated[str, typer.Argument(help="Model folder, such as runs/mel/best.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder to write, or FILE.onnx.")
    ] = None,
    onnx: Annotated[
        Path | None, typer.Option("--onnx", help="File.onnx to write, for engines and browsers.")
    ] = None,
    precision: Annotated[
        str, typer.Option(help="Weights of the .onnx file: float32, or float16 of half the size.")
    ] = "float32",
    data: Annotated[str, typer.Option(help="Description of the training data.")] = "",
    force: Annotated[bool, typer.Option("--force", help="Replace the folder.")] = False,
) -> None:
    """Write a model for distribution: a folder in half precision, or an ONNX file.

    Examples
    --------
    deitalk model export runs/mel/best -o my_model --data "my captures"

    deitalk model export default --onnx default.onnx
    """
    from deitalk.errors import DeitalkError

    if onnx is None and out is not None and out.suffix.lower() == ".onnx":
        out, onnx = None, out
    if (out is None) == (onnx is None):
        raise DeitalkError("give either --out FOLDER or --onnx FILE.onnx")
    if onnx is not None:
        _export_onnx(model, onnx, precision, force)
    elif out is not None:
        _export_folder(model, out, data, force)


def _export_onnx(model: str, out: Path, precision: str, force: bool) -> None:
    from deitalk.export.onnx_file import export_onnx, operators
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import model_folder

    source = model_folder(model)
    reserve_file(out, force=force, inputs=(source / "model.safetensors",))
    export_onnx(require_model(model, DEITalk), out, name=model, precision=precision)
    console().print(f"{out}: {out.stat().st_size / 1e6:.1f} MB")
    console().note(f"operators: {', '.join(sorted(operators(out)))}")


def _export_folder(model: str, out: Path, data: str, force: bool) -> None:
    from deitalk.models.checkpoint import portable, require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import describe_model, model_folder

    source = model_folder(model)
    reserve_folder(out, kind="model", force=force, inputs=(source / "model.safetensors",))
    network = require_model(model, DEITalk)
    config, summary = portable(source)
    summary |= {"data": data} if data else {}
    save_model(out, network, config, summary, half=True, graph=True)
    console().print(f"{out}: {describe_model(out)['bytes'] / 1e6:.1f} MB")


@app.command()
def mix(
    before: Annotated[str, typer.Argument(help="Model before a training, such as default.")],
    after: Annotated[str, typer.Argument(help="Model after it, such as runs/mine/best.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write.")],
    share: Annotated[
        float, typer.Option(min=0, max=1, help="Of the second model's weights; 0 is the first.")
    ] = 0.5,
    force: Annotated[bool, typer.Option("--force", help="Replace the folder.")] = False,
) -> None:
    """Write a model between two of the same network: a part of what a training changed.

    Rules and other settings are those of the second model. The weights are stored in half
    precision.

    Examples
    --------
    deitalk model mix default runs/mine/best --share 0.6 -o softer/
    """
    from deitalk.models.checkpoint import portable, require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import describe_model, model_folder, weights_hash
    from deitalk.training.tuning.recipe import mix_models

    folders = [model_folder(model) for model in (before, after)]
    inputs = tuple(folder / "model.safetensors" for folder in folders)
    reserve_folder(out, kind="model", force=force, inputs=inputs)
    network = mix_models(require_model(before, DEITalk), require_model(after, DEITalk), share)
    config, summary = portable(folders[1])
    summary["mixed"] = {"share": share, "sha256": [weights_hash(folder) for folder in folders]}
    save_model(out, network, config, summary, half=True, graph=True)
    console().print(f"{out}: {describe_model(out)['bytes'] / 1e6:.1f} MB")


@app.command()
def fit(
    model: Annotated[str, typer.Argument(help="Model, such as runs/anna/best.")],
    data: Annotated[Path, typer.Argument(help="Dataset folder of seconds of a take.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace the folder.")] = False,
) -> None:
    """Write a model whose face without a name is that of a take: nearest style, gains, offsets.

    Examples
    --------
    deitalk data import new_take/ --actor anna -o new_take_data/

    deitalk model fit runs/anna/best new_take_data/ -o fitted/
    """
    from deitalk.data.clips import read_clips
    from deitalk.models.checkpoint import portable, require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import model_folder
    from deitalk.training.tuning.fitting import fit_model

    source = model_folder(model)
    reserve_folder(out, kind="model", force=force, inputs=(source / "model.safetensors", data))
    clips = read_clips(data)
    found = fit_model(require_model(model, DEITalk), clips)
    config, summary = portable(source)
    save_model(out, found.model, config, summary | {"fitted": {"clips": len(clips)}})
    style = f"style {found.style}" if found.style else "its own face"
    text = f"{out}: {style}, error {found.error:.2f} of the one before on these clips"
    console().print(text)


@app.command()
def push(
    model: Annotated[str, typer.Argument(help="Model folder, such as runs/anna/best.")],
    name: Annotated[str, typer.Argument(help="org/name on the Hugging Face hub.")],
    license: Annotated[
        str | None, typer.Option(help="The hub's name of a licence, for the card.")
    ] = None,
    public: Annotated[
        bool, typer.Option("--public", help="A new repository is public; else private.")
    ] = False,
) -> None:
    """Write a model and a card made of its run's report to the Hugging Face hub.

    Examples
    --------
    deitalk model push runs/anna/best my_org/anna --license cc-by-4.0
    """
    from deitalk.models.checkpoint import push_to_hub

    emit(push_to_hub(model, name, private=not public, license=license))


@app.command()
def info(
    model: Annotated[str, typer.Argument(help="an embedded model, or a model folder.")] = "default",
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show control set, size, hash, training and rules of a model."""
    from deitalk.models.folder import describe_model, embedded_models

    about = describe_model(model)
    if as_json:
        emit_json(about)
        return
    for key, value in about.items():
        emit(f"{key}\t{json.dumps(value) if isinstance(value, dict) else value}")
    console().print(f"embedded models: {', '.join(embedded_models()) or 'none'}")
