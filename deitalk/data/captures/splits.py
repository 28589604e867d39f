"""Train, validation and test of captures: all are learnt from, unless the user says otherwise.

A tuning chooses by folds over the takes (`deitalk.training.tuning.ridge`), so that none of them
has to be kept from it: every emotion, convention and actor is learnt.

Where clips are held out, whole actors, or whole takes and blocks of time, clips of one take in
different splits are at least `APART_SECONDS` apart: neighbours share a sentence, and a model would
be tested on what it was trained on. Clips in between are left out.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from deitalk.data.clips import Clip
from deitalk.errors import DataError

TRAIN, VALIDATION, TEST = "train", "validation", "test"
LEFT_OUT = ""
SPLITS = (TRAIN, VALIDATION, TEST, LEFT_OUT)
APART_SECONDS = 5.0
"""Longer than a training window of 128 frames."""
SHARE = 1 / 8
"""Share of validation, and of test."""
LEAST_TAKES = 4
"""Takes of an actor in one emotion from which on whole takes are divided."""
BLOCK_SECONDS = 90.0
"""Material of an actor in one emotion from which on it gives blocks to all splits."""
WAYS = ("auto", "actor", "time", "none")


@dataclass(frozen=True)
class Piece:
    """Part of a clip's description that the division needs."""

    actor: str
    emotion: str
    take: str
    start: float
    stop: float
    split: str = ""
    """Given by the user; empty: to be chosen."""


def check_way(way: str) -> None:
    """Refuse a way that is none of `WAYS`."""
    if way not in WAYS:
        raise DataError(f"`split_by={way}` must be one of {', '.join(WAYS)}", parameter="split_by")


def divide(pieces: Sequence[Piece], way: str = "auto") -> list[str]:
    """Return the split of every clip; an empty one is left out.

    Parameters
    ----------
    pieces : sequence of Piece
        All clips.
    way : {"auto", "actor", "time", "none"}
        Whole actors; takes and blocks of time of every actor; or all clips for training, unless
        some have a split.

    Two or three takes, or a short one, may have no test clips. Clips that cannot be divided are all
    for training.

    Raises
    ------
    DataError
        If whole actors are wanted of fewer than three.
    """
    check_way(way)
    minutes: dict[str, float] = defaultdict(float)
    for piece in pieces:
        minutes[piece.actor] += (piece.stop - piece.start) / 60
    if way == "actor" and len(minutes) < 3:
        raise DataError(
            f"`split_by=actor` needs three actors; here are {len(minutes)}: use time",
            parameter="split_by",
        )
    if any(piece.split for piece in pieces):
        return [piece.split or TRAIN for piece in pieces]
    if way in ("auto", "none"):
        return [TRAIN] * len(pieces)
    if way == "actor":
        # Actors by split: those with least material are tested on, about an eighth each.
        count = max(1, round(SHARE * len(minutes)))
        order = sorted(minutes, key=lambda name: (minutes[name], name))
        homes = dict.fromkeys(order, TRAIN)
        homes.update(dict.fromkeys(order[:count], VALIDATION))
        homes.update(dict.fromkeys(order[count : 2 * count], TEST))
        return [homes[piece.actor] for piece in pieces]
    splits = _apart(pieces, _blocks(pieces))
    return splits if _can_validate(splits) else _few(pieces)


def _can_validate(splits: Iterable[str]) -> bool:
    """Whether there is something to train on and something to validate."""
    return {TRAIN, VALIDATION} <= set(splits)


def shortage(train: int, validation: int) -> str:
    """Message for a dataset that lacks clips to train on, or to validate where steps need some."""
    return (
        f"{train} clips to train on and {validation} to validate; steps (train.steps) need one of "
        "each: import longer or more takes, fill the column split, or leave the steps out"
    )


def _few(pieces: Sequence[Piece]) -> list[str]:
    """Little material, without a test: the last take validates, or the last clip of the only one.

    All train where that would leave an emotion out.
    """
    last = max(pieces, key=lambda piece: (piece.take, piece.start))
    is_only_take = all(piece.take == last.take for piece in pieces)
    chosen = [piece == last if is_only_take else piece.take == last.take for piece in pieces]
    splits = _apart(pieces, [VALIDATION if held else TRAIN for held in chosen])
    learnt = {piece.emotion for piece, split in zip(pieces, splits, strict=True) if split == TRAIN}
    every = {piece.emotion for piece in pieces}
    return splits if _can_validate(splits) and learnt == every else [TRAIN] * len(pieces)


class Division(NamedTuple):
    """Clips of a dataset folder by split, and those that are in none."""

    train: list[Clip]
    validation: list[Clip]
    test: list[Clip]
    between: list[Clip]


def divide_clips(clips: Sequence[Clip], leave_out: str | None = None) -> Division:
    """Clips by their split; or a take or an actor for the test, and the rest divided anew.

    The rest is for training, but for the last clip of every take of three and more, which is for
    validation (of shorter takes, the last clip), and for its neighbours, which are left out.

    Parameters
    ----------
    clips : sequence of Clip
        All of a dataset folder.
    leave_out : str or None
        Name of a take or of an actor.

    Raises
    ------
    DataError
        If no clip, or every clip, is of that name.
    """
    if leave_out is None:
        return Division(*([c for c in clips if c.split == s] for s in SPLITS))
    is_held = [leave_out in (clip.take_name, clip.speaker) for clip in clips]
    if not any(is_held) or all(is_held):
        some = ", ".join([*names_of(clips, "takes"), *names_of(clips, "actors")][:6])
        raise DataError(
            f"`leave_out={leave_out}` must be one of several takes or actors, such as {some}",
            parameter="leave_out",
        )
    rest = [clip for clip, held in zip(clips, is_held, strict=True) if not held]
    splits = _apart(
        [Piece(c.speaker, c.emotion, c.take_name, *c.span) for c in rest], _last_of_takes(rest)
    )
    train, validation, _, between = (
        [clip for clip, given in zip(rest, splits, strict=True) if given == split]
        for split in SPLITS
    )
    test = [clip for clip, held in zip(clips, is_held, strict=True) if held]
    return Division(train, validation, test, between)


def last_takes(division: Division) -> Division:
    """A division whose last take of every actor in every emotion validates, where there are two.

    Where no actor has two takes in an emotion, the last clips of takes do, as in `divide_clips`.
    """
    takes: dict[tuple[str, str], list[str]] = defaultdict(list)
    for clip in division.train:
        takes[clip.group].append(clip.take_name)
    last = {group: names[-1] for group, names in takes.items() if len(set(names)) > 1}
    splits = [
        VALIDATION if last.get(clip.group) == clip.take_name else TRAIN for clip in division.train
    ]
    if not last:
        pieces = [Piece(c.speaker, c.emotion, c.take_name, *c.span) for c in division.train]
        splits = _apart(pieces, _last_of_takes(division.train))
    train, validation, between = (
        [clip for clip, given in zip(division.train, splits, strict=True) if given == split]
        for split in (TRAIN, VALIDATION, LEFT_OUT)
    )
    return Division(train, validation, division.test, [*division.between, *between])


def _last_of_takes(clips: Sequence[Clip]) -> list[str]:
    """Validation for the last clip of every take of three and more, or else the last clip."""
    takes: dict[str, list[Clip]] = defaultdict(list)
    for clip in sorted(clips, key=lambda clip: clip.span):
        takes[clip.take_name].append(clip)
    chosen = [take[-1] for take in takes.values() if len(take) >= 3] or [clips[-1]]
    return [VALIDATION if clip in chosen else TRAIN for clip in clips]


def names_of(clips: Sequence[Clip], kind: str) -> list[str]:
    """Names of all ``takes`` or ``actors``, sorted."""
    of_actors = kind == "actors"
    return sorted({clip.speaker if of_actors else clip.take_name for clip in clips})


def _blocks(pieces: Sequence[Piece]) -> list[str]:
    """Takes or blocks of time of every actor in every emotion."""
    splits = [TRAIN] * len(pieces)
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for place, piece in enumerate(pieces):
        groups[piece.actor, piece.emotion].append(place)
    for places in groups.values():
        _divide_group(pieces, places, splits, BLOCK_SECONDS)
    for actor in {piece.actor for piece in pieces}:  # of little material in each emotion
        places = [i for i, piece in enumerate(pieces) if piece.actor == actor]
        if all(splits[i] == TRAIN for i in places):
            _divide_group(pieces, places, splits, 0.0)
    return splits


def _divide_group(
    pieces: Sequence[Piece], places: Sequence[int], splits: list[str], least: float
) -> None:
    """Give some of a group's clips to validation and test."""
    order = sorted(places, key=lambda i: (pieces[i].take, pieces[i].start))
    takes = list(dict.fromkeys(pieces[i].take for i in order))
    if len(takes) >= LEAST_TAKES:
        emotions = {
            take: {pieces[i].emotion for i in order if pieces[i].take == take} for take in takes
        }
        left = list(takes)
        for split in (TEST, VALIDATION):
            for _ in range(max(1, round(SHARE * len(takes)))):
                _hold_out(pieces, order, splits, left, emotions, split)
        return
    total = sum(pieces[i].stop - pieces[i].start for i in order)
    if total < least or len(order) < 3:
        return
    done = 0.0
    for i in order:
        length = pieces[i].stop - pieces[i].start
        middle = (done + length / 2) / total
        done += length
        if middle >= 1 - 2 * SHARE:
            splits[i] = TEST if middle >= 1 - SHARE else VALIDATION
    splits[order[-1]] = TEST  # of a few long clips
    if all(splits[i] != VALIDATION for i in order):
        splits[order[-2]] = VALIDATION


def _hold_out(
    pieces: Sequence[Piece],
    order: Sequence[int],
    splits: list[str],
    left: list[str],
    emotions: dict[str, set[str]],
    split: str,
) -> None:
    """Give the last take to a split whose emotions others show, else the last third of the last."""
    others = {take: set().union(*(emotions[t] for t in left if t != take)) for take in left}
    whole = next((take for take in reversed(left) if emotions[take] <= others[take]), None)
    take = whole or left[-1]
    left.remove(take)
    own = [i for i in order if pieces[i].take == take]
    for i in own if whole else own[len(own) - len(own) // 3 :]:
        splits[i] = split


def _apart(pieces: Sequence[Piece], splits: list[str]) -> list[str]:
    """Leave out clips for training, then for validation, that are near one of another split."""
    result = list(splits)
    takes: dict[str, list[int]] = defaultdict(list)
    for place, piece in enumerate(pieces):
        takes[piece.take].append(place)
    for places in takes.values():
        for mine, others in ((TRAIN, (VALIDATION, TEST)), (VALIDATION, (TEST,))):
            for i in places:
                near = any(
                    max(pieces[i].start - pieces[j].stop, pieces[j].start - pieces[i].stop)
                    < APART_SECONDS
                    for j in places
                    if splits[j] in others
                )
                if splits[i] == mine and near:
                    result[i] = LEFT_OUT
    return result
