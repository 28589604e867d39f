"""`push_to_hub` uploads model folders to the Hugging Face hub, with a card.

The card is written from the files of the folder and the report of its run.
"""

import json
from pathlib import Path
from typing import Any

from deitalk.config.hub import cause, check_repository, model_files
from deitalk.config.load import AnyConfig, load_model_config, model_text, without_paths
from deitalk.errors import CheckpointError
from deitalk.models.folder import (
    describe_model,
    model_folder,
    read_about,
)
from rig import limits
from rig.files.reading import read_json, read_text

REPORT = "report.md"
"""Beside the model folder, where `deitalk finetune` wrote one."""


def portable(name_or_path: str | Path) -> tuple[AnyConfig, dict[str, Any]]:
    """Settings and training summary of a model without folders of this machine."""
    config = without_paths(load_model_config(model_folder(name_or_path)))
    summary = dict(read_about(model_folder(name_or_path))["training"])
    if "@" not in (base := summary.get("base", "@")):  # a commit on the hub has one
        summary["base"] = Path(base).name
    return config, summary


def push_to_hub(
    model: str | Path, name: str, *, private: bool = True, license: str | None = None
) -> str:
    """Write a model into a repository of the Hugging Face hub, in one commit with its card.

    Parameters
    ----------
    model : str or Path
        A model folder, such as ``runs/anna/best``; its weights are not changed.
    name : str
        ``org/name``; made if it is not there.
    private : bool
        Whether a new repository is for its owners only.
    license : str or None
        The hub's name of a licence, such as ``cc-by-4.0``, for the card.

    Returns
    -------
    str
        Address of the commit.

    Raises
    ------
    CheckpointError
        If there is no such model, the name is none of a repository, or the hub refuses.
    """
    from huggingface_hub import CommitOperationAdd, HfApi

    check_repository(name)
    folder, (config, summary) = model_folder(model), portable(model)
    about = read_about(folder) | {"training": summary}
    texts = {
        "README.md": model_card(folder, name, license),
        "config.yaml": model_text(config),
        "model.json": json.dumps(about, indent=1) + "\n",
    }
    given: dict[str, Any] = {file: text.encode() for file, text in texts.items()}
    files = model_files(path.name for path in folder.iterdir() if path.is_file())
    given |= {f: folder / f for f in files if f not in given}
    try:
        api = HfApi(library_name="deitalk")
        api.create_repo(name, private=private, exist_ok=True)
        added = [CommitOperationAdd(path_in_repo=f, path_or_fileobj=x) for f, x in given.items()]
        return str(api.create_commit(name, added, commit_message="deitalk model push").commit_url)
    except Exception as error:  # of the package, its client of HTTP, and the disk
        raise CheckpointError(f"{name}: not pushed ({cause(error)}") from None


def model_card(folder: Path, name: str, license: str | None = None) -> str:
    """Text of a model's card, in Markdown with the hub's header.

    Parameters
    ----------
    folder : Path
        Of the model; with `REPORT` beside it, the card ends with that.
    name : str
        ``org/name``.
    license : str or None
        As for `push_to_hub`.
    """
    about, (config, summary) = describe_model(folder), portable(folder)
    base = str(summary.get("base", ""))
    head = _card_data(folder, name, license, base)
    facts = {
        "control set": about["control_set"],
        "parameters": f"{about['parameters']:,}",
        "actors": ", ".join(getattr(config.model, "actors", ())),
        "base": base,
        "steps": summary.get("step"),
        "data": summary.get("data"),
        "SHA-256 of the weights": about["sha256"],
    }
    product = "A moving mesh" if config.product == "mesh" else "Curves of a face rig"
    report = folder.parent / REPORT
    lines = [
        f"---\n{head}\n---\n# {name}\n",
        f"{product} from speech, for deitalk.\n",
        f"```\ndeitalk animate speech.wav --model {name} -o take/\n```\n",
        "| | |\n|---|---|",
        *(f"| {key} | {value} |" for key, value in facts.items() if value not in (None, "")),
    ]
    if report.is_file():
        lines += ["", "#" + read_text(report, limits.MODEL_JSON_BYTES, error=CheckpointError)]
    return "\n".join(lines).rstrip() + "\n"


SCORED = ("error_of_mean_pose", "mean_r", "range", "jaw_r", "bilabial_window_auc")
"""Scores of a report that a card's header has."""


def _card_data(folder: Path, name: str, license: str | None, base: str) -> str:
    """Header of a card, as YAML: what the hub filters by, and scores of the run's report."""
    from huggingface_hub import EvalResult, ModelCardData

    path, results = folder.parent / "report.json", []
    report = (
        read_json(path, limits.MODEL_JSON_BYTES, error=CheckpointError) if path.is_file() else {}
    )
    scores = report.get("scores", {}).get("after", {}) if isinstance(report, dict) else {}
    for score in SCORED:
        if isinstance(scores.get(score), int | float):
            results.append(
                EvalResult(
                    task_type="other",
                    task_name="Speech to facial animation",
                    dataset_type="captures",
                    dataset_name=f"{report.get('clips', 0)} held-out clips",
                    metric_type=score,
                    metric_name=score,
                    metric_value=scores[score],
                )
            )
    data = ModelCardData(
        library_name="deitalk",
        pipeline_tag="other",
        tags=["speech", "facial-animation"],
        license=license,
        base_model=base.partition("@")[0] if "@" in base else None,
        model_name=name.rpartition("/")[2] if results else None,
        eval_results=results or None,
    )
    return str(data.to_yaml())
