"""Models to the Hugging Face hub, with a card made of what the folder and its run's report say."""

import json
from pathlib import Path
from typing import Any

import yaml

from deitalk.config.hub import FILES, check_repository
from deitalk.config.load import AnyConfig, load_config, without_paths
from deitalk.errors import CheckpointError
from deitalk.models.folder import describe_model, model_folder, read_about
from rig import limits
from rig.errors import shorten
from rig.files.reading import read_text

REPORT = "report.md"
"""Beside the model folder, where `deitalk finetune` wrote one."""


def portable(name_or_path: str | Path) -> tuple[AnyConfig, dict[str, Any]]:
    """Settings and training summary of a model without folders of this machine."""
    config = without_paths(load_config(model_folder(name_or_path) / "config.yaml"))
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
        "config.yaml": yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False),
        "model.json": json.dumps(about, indent=1) + "\n",
    }
    given: dict[str, Any] = {file: text.encode() for file, text in texts.items()}
    given |= {f: folder / f for f in FILES if f not in given and (folder / f).is_file()}
    try:
        api = HfApi(library_name="deitalk")
        api.create_repo(name, private=private, exist_ok=True)
        added = [CommitOperationAdd(path_in_repo=f, path_or_fileobj=x) for f, x in given.items()]
        return str(api.create_commit(name, added, commit_message="deitalk model push").commit_url)
    except Exception as error:  # of the package, its client of HTTP, and the disk
        reason = shorten(" ".join(str(error).split()), 200)
        raise CheckpointError(f"{name}: not pushed ({reason}); `hf auth login` logs in") from None


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
    head = {"library_name": "deitalk", "tags": ["speech", "facial-animation"]}
    head |= {"license": license} if license else {}
    head |= {"base_model": base.partition("@")[0]} if "@" in base else {}
    facts = {
        "control set": about["control_set"],
        "parameters": f"{about['parameters']:,}",
        "actors": ", ".join(getattr(config.model, "actors", ())),
        "base": base,
        "steps": summary.get("step"),
        "data": summary.get("data"),
        "SHA-256 of the weights": about["sha256"],
    }
    product = "A moving mesh" if config.kind == "sdfa" else "Curves of a face rig"
    report = folder.parent / REPORT
    lines = [
        f"---\n{yaml.safe_dump(head, sort_keys=False)}---\n# {name}\n",
        f"{product} from speech, for deitalk.\n",
        f"```\ndeitalk animate speech.wav --model {name} -o take/\n```\n",
        "| | |\n|---|---|",
        *(f"| {key} | {value} |" for key, value in facts.items() if value not in (None, "")),
    ]
    if report.is_file():
        lines += ["", "#" + read_text(report, limits.MODEL_JSON_BYTES, error=CheckpointError)]
    return "\n".join(lines).rstrip() + "\n"
