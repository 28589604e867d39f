"""Division into splits: nothing is in two, and neighbours are in one."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.data.captures.splits import APART_SECONDS, TEST, TRAIN, VALIDATION, Piece, divide
from deitalk.errors import DataError


def take(actor: str, emotion: str, name: str, n: int, length: float = 10.0) -> list[Piece]:
    return [Piece(actor, emotion, name, 10.5 * i, 10.5 * i + length) for i in range(n)]


@given(st.lists(st.tuples(st.sampled_from("ab"), st.sampled_from(["happy", "sad"]),
                          st.integers(1, 40)), min_size=1, max_size=8))  # fmt: skip
@settings(max_examples=60)
def test_clips_of_one_take_in_two_splits_are_apart(takes):
    pieces = [p for i, (who, how, n) in enumerate(takes) for p in take(who, how, f"t{i}", n)]
    splits = divide(pieces, "time")
    for one, mine in zip(pieces, splits, strict=True):
        for other, its in zip(pieces, splits, strict=True):
            if one.take == other.take and mine and its and mine != its:
                assert max(one.start - other.stop, other.start - one.stop) >= APART_SECONDS


def test_one_long_take_gives_blocks_at_its_end():
    splits = divide(take("anna", "happy", "t", 57), "time")  # ten minutes
    kept = [split for split in splits if split]
    assert kept == sorted(kept, key=(TRAIN, VALIDATION, TEST).index)
    assert kept.count(TEST) == pytest.approx(57 / 8, abs=1.5)
    assert kept.count(VALIDATION) == pytest.approx(57 / 8, abs=2)
    assert splits.count("") <= 3


def test_many_takes_are_kept_whole_and_every_emotion_is_in_every_split():
    pieces = [
        p for how in ("happy", "sad") for i in range(8) for p in take("a", how, how + str(i), 2)
    ]
    splits = divide(pieces, "time")
    assert "" not in splits
    homes = {(p.take, s) for p, s in zip(pieces, splits, strict=True)}
    assert len(homes) == 16
    for emotion in ("happy", "sad"):
        assert {s for p, s in zip(pieces, splits, strict=True) if p.emotion == emotion} == {
            TRAIN, VALIDATION, TEST,
        }  # fmt: skip


@pytest.mark.parametrize("clips", [1, 2, 3])
@pytest.mark.parametrize("takes", [2, 3])
def test_two_and_three_takes_have_clips_to_train_on_and_to_validate(takes, clips):
    """The first take trains; three takes of one clip have a test too."""
    pieces = [p for i in range(takes) for p in take("a", "sad", f"t{i}", clips)]
    splits = divide(pieces, "time")
    assert {TRAIN, VALIDATION} <= set(splits)
    homes = {
        p.take: {s for q, s in zip(pieces, splits, strict=True) if q.take == p.take} for p in pieces
    }
    assert homes["t0"] == {TRAIN}


def test_actors_need_three_and_the_way_is_checked():
    with pytest.raises(DataError, match="needs three actors; here are 1"):
        divide(take("a", "sad", "t", 5), "actor")
    with pytest.raises(DataError, match="must be one of auto, actor, time"):
        divide(take("a", "sad", "t", 5), "clip")


EMOTIONS = ("angry", "happy", "neutral", "sad", "surprised")


@pytest.mark.parametrize("clips", [1, 2, 3, 4])
@pytest.mark.parametrize("takes", [1, 2, 3])
@pytest.mark.parametrize("way", ["auto", "none", "time"])
def test_every_emotion_is_learnt(way, takes, clips):
    """Whatever the number of its takes; by time there are other clips too, where takes allow it."""
    pieces = [
        piece
        for how in EMOTIONS
        for number in range(takes)
        for piece in take("a", how, f"{how}{number}", clips)
    ]
    homes = {(p.emotion, s) for p, s in zip(pieces, divide(pieces, way), strict=True)}
    assert {how for how, split in homes if split == TRAIN} == set(EMOTIONS)
    held = {split for _, split in homes} - {TRAIN, ""}
    assert bool(held) == (way == "time" and (takes > 1 or clips > 2))


def test_by_default_all_clips_are_learnt():
    pieces = [p for who in "abcd" for p in take(who, "sad", who, 3)]
    assert set(divide(pieces)) == {TRAIN}
