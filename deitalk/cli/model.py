"""`deitalk model`: description of a model, export of a copy, a mix of two, the hub."""

import json
from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console, emit, emit_json
from deitalk.cli.options import CheckedCommands, ForceFolder, share_of
from deitalk.cli.targets import reserve_file, reserve_folder

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
    force: ForceFolder = False,
) -> None:
    """Write a model for distribution: a folder in half precision, or an ONNX file.

    Examples
    --------
    deitalk model export runs/mel/best -o my_model --data "my captures"

    deitalk model export default --onnx default.onnx
    """
    from deitalk.errors import DeitalkError
    from rig.files import is_folder_name

    if onnx is None and out is not None and out.suffix.lower() == ".onnx":
        out, onnx = None, out
    if (out is None) == (onnx is None):
        raise DeitalkError("give either --out FOLDER or --onnx FILE.onnx")
    if out is not None:
        is_folder_name(out, (".onnx",))  # raises for the name of another file
    from deitalk.models.checkpoint import require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import describe_model, model_folder
    from deitalk.models.hub import portable

    source = model_folder(model)
    inputs = (source / "model.safetensors",)
    if onnx is not None:
        from deitalk.export.onnx_file import export_onnx, operators

        reserve_file(onnx, force=force, inputs=inputs)
        export_onnx(require_model(model, DEITalk), onnx, name=model, precision=precision)
        console().print(f"{onnx}: {onnx.stat().st_size / 1e6:.1f} MB")
        console().note(f"operators: {', '.join(sorted(operators(onnx)))}")
    elif out is not None:
        reserve_folder(out, kind="model", force=force, inputs=inputs)
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
        float, typer.Option(parser=share_of, help="Of the second model's weights; 0 is the first.")
    ] = 0.5,
    force: ForceFolder = False,
) -> None:
    """Write a model between two of the same network: a part of what a training changed.

    Rules and other settings are those of the second model. The weights are stored in half
    precision.

    Examples
    --------
    deitalk model mix default runs/mine/best --share 0.6 -o softer/
    """
    from deitalk.models.checkpoint import require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import describe_model, model_folder, weights_hash
    from deitalk.models.hub import portable
    from deitalk.training.tuning.mix import mix_models

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
    force: ForceFolder = False,
) -> None:
    """Write a model whose face without a name is that of a take: nearest style, gains, offsets.

    Examples
    --------
    deitalk data import new_take/ --actor anna -o new_take_data/

    deitalk model fit runs/anna/best new_take_data/ -o fitted/
    """
    from deitalk.data.clips import read_clips
    from deitalk.models.checkpoint import require_model, save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.models.folder import model_folder
    from deitalk.models.hub import portable
    from deitalk.training.tuning.fitting import fit_model

    source = model_folder(model)
    reserve_folder(out, kind="model", force=force, inputs=(source / "model.safetensors", data))
    clips = read_clips(data)
    found = fit_model(require_model(model, DEITalk), clips)
    config, summary = portable(source)
    save_model(out, found.model, config, summary | {"fitted": {"clips": len(clips)}}, graph=True)
    style = f"style {found.style}" if found.style else "its own face"
    text = f"{out}: {style}, error {found.error:.2f} of the one before on these clips"
    console().print(text)


@app.command()
def score(
    model: Annotated[str, typer.Argument(help="Model of any rig, such as runs/anna/best.")],
    data: Annotated[Path, typer.Argument(help="Dataset folder of captures it never saw.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the report.")],
    force: ForceFolder = False,
) -> None:
    """Score a tuned model on new captures, beside their mean pose and loudness.

    Clips are predicted in the style of their actor; where the model has none of the name, in that
    of nobody. Every style is scored too.

    Examples
    --------
    deitalk model score runs/anna/best new_takes_data/ -o scores/
    """
    from deitalk.cli.finetune import print_scores
    from deitalk.data.clips import read_clips
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.training.tuning.fitting import score_model
    from rig.files import output_folder

    reserve_folder(out, kind="scores", force=force, inputs=(data,))
    network, clips = require_model(model, DEITalk), read_clips(data)
    with output_folder(out, kind="scores", force=force) as beside:
        scores = score_model(network, clips, beside)
    print_scores(scores)
    console().print(f"{out / 'report.md'}: scores and controls")


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
    from deitalk.models.hub import push_to_hub

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
