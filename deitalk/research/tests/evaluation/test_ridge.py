"""Ridge regressions beside the scores of curves, and contacts on tables of phones."""

import numpy as np
import pytest
import soundfile

from deitalk.audio.load import load_audio
from deitalk.errors import CheckpointError, DataError
from deitalk.research.evaluation import contacts
from deitalk.research.evaluation.contacts import (
    as_markdown,
    contact_scores,
    read_table,
    shut_beside_vowels,
    shut_sounds,
)
from deitalk.research.evaluation.ridge import (
    REACH,
    Readout,
    contact_targets,
    in_context,
    listen,
    losses,
)

HEADER = "clip,start,end,label,kind\n"


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_ridge_finds_a_linear_law_of_frames_before_and_after(rng):
    features = rng.normal(size=(3, 400, 4)).astype(np.float32)
    law = rng.normal(size=(4 * (2 * REACH + 1), 2))
    rows = [(f, (in_context(f) @ law + 5).astype(np.float32)) for f in features]
    readout = Readout.fit(rows[:2], penalty=1e-3)
    inner = slice(REACH, -REACH)
    np.testing.assert_allclose(readout(features[2])[inner], rows[2][1][inner], atol=0.1)


def test_frames_without_targets_teach_nothing(rng):
    features = rng.normal(size=(100, 2)).astype(np.float32)
    targets = features[:, :1].copy()
    wrong = np.where(np.arange(100)[:, None] < 50, targets, np.nan)
    assert np.corrcoef(Readout.fit([(features, wrong)])(features)[:, 0], targets[:, 0])[0, 1] > 0.9
    with pytest.raises(DataError, match="no frame teaches"):
        Readout.fit([(features, np.full((100, 1), np.nan, np.float32))])


def test_a_recording_counts_by_its_share(rng):
    """Two laws that contradict one another: the one with the larger share wins."""
    features = rng.normal(size=(500, 1)).astype(np.float32)
    rows = [(features, features), (features, -features)]
    read = Readout.fit(rows, shares=[1.0, 0.1], penalty=1.0)
    assert np.corrcoef(read(features)[:, 0], features[:, 0])[0, 1] > 0.9


def test_contact_targets_are_the_frames_of_bilabials():
    phones = [(0.0, 0.1, "SIL"), (0.1, 0.2, "B"), (0.2, 0.3, "V"), (0.3, 0.4, "AA")]
    assert contact_targets(phones, 12)[:, 0].tolist() == [0, 0, 0, 1, 1, 1, *[0] * 6]


def test_an_encoder_that_is_not_there_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(CheckpointError, match="no Whisper checkpoint"):
        listen(None, tmp_path)


def test_scores_below_the_ridge_are_named():
    own = {"a": {"r": 0.9, "auc": 0.8}}
    assert "a, r: 0.880, the ridge 0.900" in losses({"a": {"r": 0.88, "auc": 0.795}}, own)
    assert losses({"a": {"r": 0.895, "auc": 0.9}}, own).endswith("none.")


@pytest.fixture
def judged(tmp_path):
    (tmp_path / "sounds").mkdir()
    soundfile.write(tmp_path / "sounds" / "a.wav", np.zeros(16000), 16000)
    rows = "a,0.0,0.1,sil,silence\na,0.1,0.2,m,closure\na,0.2,0.4,a,vowel\na,0.4,0.5,n,other\n"
    (tmp_path / "phones.csv").write_text(HEADER + rows)
    return tmp_path / "phones.csv"


def test_a_table_of_phones_is_read_by_kinds(judged):
    (clip,) = read_table(judged)
    assert [name for _, _, name in clip.phones] == ["SIL", "M", "AA", "T"]
    assert load_audio(clip.audio).n_frames == 30


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("clip,start,end,label\n", "lacks the column kind"),
        (HEADER, "holds no sound"),
        (HEADER + "a,0,1,m,nasal\n", "known are closure"),
        (HEADER + "a,0,x,m,closure\n", "line 2: start and end"),
        (HEADER + "b,0,1,m,closure\n", "no sound of"),
    ],
)
def test_other_tables_are_refused_in_one_line(judged, text, reason):
    judged.write_text(text)
    with pytest.raises(DataError, match=reason) as caught:
        read_table(judged)
    assert "\n" not in str(caught.value)


def test_lips_that_shut_beside_a_vowel_are_counted_away_from_labials():
    """Vowels at 0.2 and at 1.0 s; the lips shut at 0.5 s, in the n after the first."""
    lips = np.zeros(60, np.float32)
    lips[15] = 0.6
    vowels = [(0.2, 0.45, "AA"), (0.45, 0.6, "T"), (1.0, 1.2, "AA")]
    assert shut_beside_vowels(lips, vowels) == (2, 1)
    assert shut_beside_vowels(lips, [*vowels, (0.56, 0.65, "M")]) == (1, 0)


def test_shut_sounds_and_scores_of_lips_that_follow_the_phones():
    sounds = [(0.3 * i, 0.3 * i + 0.1, "n", "other") for i in range(6)]
    sounds += [(2.5, 2.6, "m", "closure"), (3.0, 3.2, "a", "vowel")]
    clip = contacts.Labelled(None, tuple(sounds))
    lips = np.zeros(120, np.float32)
    lips[0:3] = lips[75:78] = 1
    assert shut_sounds([(lips, clip)]) == {"n": {"n": 6, "shut": pytest.approx(1 / 6)}}
    scores = contact_scores([(lips, clip)])
    assert scores["bilabial_hits_at_5_percent"] == scores["bilabial_frame_auc"] == 1
    assert (scores["shut_beside_free_vowels"], scores["free_vowels"]) == (0, 1)
    page = as_markdown(
        {"scores": {"animated": scores, "ridge: own": scores}, "shut": shut_sounds([(lips, clip)])}
    )
    assert "| n |" in page and "none." in page
