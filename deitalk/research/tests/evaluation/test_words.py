"""Score of known words: a spoken line without words, with its own, with others."""

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.models.load import load_network
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.transcript import Transcript
from deitalk.research.corpus.engines import espeak
from deitalk.research.evaluation.words import (
    CONDITIONS,
    LINES,
    Take,
    as_markdown,
    exchanged,
    main,
    measure,
    recorded,
)


def test_every_fourth_word_is_exchanged():
    words = Transcript(tuple(Word(str(i), ("AA",)) for i in range(6)), "")
    others = Transcript((Word("x", ("M",)),), "")
    assert [w.text for w in exchanged(words, others).words] == ["0", "1", "2", "x", "4", "5"]


def test_words_raise_closures_and_wrong_words_do_not_lower_them():
    takes = []
    for text in ("Pump my bubble up.", "See the car turn, Ann."):
        said = espeak.synthesise(text)
        phones = [(p.start, p.end, p.name) for p in said.phones]
        takes.append(Take("lines", said.waveform, phones, text, "en-us"))
    found = measure(load_network("default"), takes)["lines"]
    means = {name: np.concatenate([c.closures for c in found[name]]).mean() for name in CONDITIONS}
    assert means["own words"] == pytest.approx(1) and means["own words"] >= means["no words"]
    assert means["words of another"] == pytest.approx(means["no words"])
    lines = as_markdown({"lines": found}).splitlines()
    assert lines[0] == "| bilabials found | lines |" and lines[-1].startswith("| bilabials | 7")


def test_lines_have_enough_bilabials():
    for language, lines in LINES.items():
        words = [word for text in lines for word in Transcript.of(text, language).words]
        assert sum(phone in "PBM" for word in words for phone in word.phones) >= 40


def test_folder_without_transcripts_is_refused(tmp_path):
    (tmp_path / "clips.csv").write_text("clip,audio,curves,emotion,speaker,split\n")
    with pytest.raises(DataError, match="no transcript with phones"):
        recorded(tmp_path, "validation", None)
    assert main(["--data", str(tmp_path / "none")]) == 1
