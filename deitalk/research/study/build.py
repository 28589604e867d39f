"""The folder of a study: a page, its clips under blind names, and the key that stays behind."""

import json
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.errors import DataError
from deitalk.research.study.clips import (
    DIFFERENCE_SECONDS,
    LOUDNESS,
    VIDEO,
    Clip,
    System,
    common_items,
    loudness_clip,
    read_clip,
    read_system,
    still_clip,
)
from deitalk.research.study.design import TASKS, all_trials, page_rows, plan_raters
from rig.face.identity import Identity
from rig.files import output_folder

KIND = "study"
PAGE, CLIPS, KEY = "index.html", "clips", "key.json"
SCHEMA = "deitalk.study/1"
PLACE = "__STUDY__"
"""Where the page's data is in its template."""


def build_study(
    folders: Sequence[Path],
    out: Path,
    *,
    tasks: Sequence[str] = tuple(TASKS),
    size: int = 2,
    most: int | None = None,
    raters: int = 60,
    with_loudness: bool = False,
    identity: int | str | Identity = 0,
    post: str | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Write a study of takes of several systems on the same recordings.

    Parameters
    ----------
    folders : sequence of Path
        One a system, named as the system: take folders, files of curves, or ``.mp4`` videos, which
        are matched by name. Curves without a recording get that of the take of the same name.
    out : Path
        Folder to write: ``index.html`` and ``clips/`` to publish, ``key.json`` to keep.
    tasks : sequence of str
        Names of `deitalk.research.study.design.TASKS`.
    size : int
        Systems side by side: 2, or 3.
    most : int or None
        Trials of one rater; all if None.
    raters : int
        Sequences in the page; ``index.html?rater=7`` shows the seventh, else one is drawn.
    with_loudness : bool
        Add a system whose jaw follows the level of the recording.
    identity : int, str or Identity
        Face on which takes are drawn.
    post : str or None
        URL to which the page sends answers; they can always be saved as a file.
    seed : int
        Seed of names, sequences and sides.
    force : bool
        Replace a study.
    progress : callable
        Called with the share of the clips that are drawn.

    Returns
    -------
    dict
        The key: systems, items, trials, and what every clip is.

    Raises
    ------
    DataError
        If systems have no item in common, or clips of one item differ in length.
    PreviewError
        If a take cannot be shown, or a video not be written.
    rig.errors.TargetError
        If the folder exists and `force` is not set.
    """
    systems = [read_system(folder) for folder in folders]
    items = common_items(systems)
    clips = _read(systems, items)
    names = [system.name for system in systems]
    if with_loudness:
        names = _add_loudness(clips, names, items)
    plans = plan_raters(all_trials(names, items, tasks, size), raters, most=most, seed=seed)
    rng = np.random.default_rng(seed)
    blind = {key: rng.bytes(8).hex() for key in clips}
    still = {item: still_clip(clips[item, names[0]]) for item in items}
    frozen = {item: rng.bytes(8).hex() for item, clip in still.items() if clip is not None}
    pages = [page_rows(plan, blind, frozen, rng) for plan in plans]
    key = {
        "schema": SCHEMA,
        "study": rng.bytes(8).hex(),
        "systems": names,
        "clips": {name: {"item": i, "system": s} for (i, s), name in blind.items()}
        | {name: {"item": item, "system": None} for item, name in frozen.items()},
        "tasks": {task: TASKS[task] for task in tasks},
        "seed": seed,
    }
    wanted = {name: clips[pair] for pair, name in blind.items()}
    wanted |= {name: clip for item, name in frozen.items() if (clip := still[item]) is not None}
    with output_folder(out, kind=KIND, force=force, inputs=folders) as stage:
        (stage / CLIPS).mkdir()
        for number, (name, clip) in enumerate(wanted.items(), 1):
            clip.write(stage / CLIPS / f"{name}{VIDEO}", identity)
            progress(number / len(wanted))
        # The page with its data; systems and their names are not in it.
        data = {"study": key["study"], "tasks": key["tasks"], "raters": pages, "post": post}
        text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
        template = files("deitalk.research.study").joinpath("page.html").read_text(encoding="utf-8")
        (stage / PAGE).write_text(template.replace(PLACE, text), encoding="utf-8")
        (stage / KEY).write_text(json.dumps(key, indent=1) + "\n", encoding="utf-8")
    return key


def _read(systems: Sequence[System], items: Sequence[str]) -> dict[tuple[str, str], Clip]:
    """All clips; those of one item must have the same length."""
    clips: dict[tuple[str, str], Clip] = {}
    for item in items:
        takes = [s.items[item] for s in systems if (s.items[item] / "audio.wav").is_file()]
        audio = takes[0] / "audio.wav" if takes else None
        for system in systems:
            clips[item, system.name] = read_clip(system.items[item], audio)
        lengths = {s.name: clips[item, s.name].seconds for s in systems}
        if max(lengths.values()) - min(lengths.values()) > DIFFERENCE_SECONDS:
            shown = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in lengths.items())
            raise DataError(f"{item}: clips of one item must have one length, not {shown}")
    return clips


def _add_loudness(
    clips: dict[tuple[str, str], Clip], names: Sequence[str], items: Sequence[str]
) -> list[str]:
    """Add clips of the loudness system, made from the first system's takes."""
    if LOUDNESS in names:
        raise DataError(f"a system is named {LOUDNESS!r} already; rename its folder")
    for item in items:
        made = loudness_clip(clips[item, names[0]])
        if made is None:
            raise DataError(f"{item}: loudness needs takes or curves of {names[0]}, not videos")
        clips[item, LOUDNESS] = made
    return [*names, LOUDNESS]
