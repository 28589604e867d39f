"""Closures with known words: ``python -m deitalk.research.evaluation.words --data FOLDER``.

Every recording of a dataset folder that has phone times and a transcript is animated neutral
without words, with its own, with those of another recording, and with every fourth of its words
exchanged; then German and Mandarin lines of espeak-ng, which are in no training corpus, without and
with words. Bilabials found are counted as in `deitalk.evaluation.validation`: at 5 % false alarms
over clear vowels of the same condition, within the phone ±2 frames.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from deitalk.acting import Acting
from deitalk.audio.load import load_audio
from deitalk.data.clips import read_clips, read_phones
from deitalk.errors import DataError
from deitalk.evaluation.report import table
from deitalk.evaluation.smoothness import lips_together
from deitalk.evaluation.validation import ClosureScores, closure_scores, summarise_closures
from deitalk.models.load import load_network
from deitalk.models.protocol import CurveNetwork
from deitalk.pipeline.curves import finish, prepare
from deitalk.pipeline.words.align import fit_words
from deitalk.pipeline.words.evidence import measure_phones, phone_evidence
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.transcript import Transcript
from deitalk.postprocess.phones import Phones
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.corpus.engines import espeak
from deitalk.research.evaluation.report import identified, write_json
from rig.arrays import Float32

CONDITIONS = ("no words", "own words", "words of another", "a quarter exchanged")
VOICES = ("f2", "m3")
"""Variants of espeak-ng that read the lines."""
LINES = {
    "de": (
        "Am Abend bringt Emma ihrem Papa einen bunten Becher Apfelmus.",
        "Bitte komm doch pünktlich, sonst beginnen wir ohne dich.",
        "Unser Nachbar pumpt am Sonntag das Boot an der Mole auf.",
        "Im Sommer blühen am Bach immer blaue Blumen.",
        "Warum haben Sie mir gestern nicht den Bericht gebracht?",
        "Die Polizei sperrt bis Mittwoch die obere Brücke.",
        "Ein dummer Bub warf Bomben aus Papier über den Baum.",
        "Hast du auch genug Proviant für den Nachmittag mitgenommen?",
        "Mein Problem ist, dass der Computer immer wieder abbricht.",
        "Oben im Turm brummt leise eine uralte Pumpe.",
    ),
    "cmn": (
        "爸爸和妈妈明天要去北京跑步。",
        "我的朋友不喜欢吃苹果和面包。",
        "明明买了一本漂亮的笔记本。",
        "门旁边有八只白色的小猫。",
        "请你帮我把票放在包里面。",
        "他们每天晚上都比我跑得慢。",
        "妹妹怕胖,所以不买便宜的饼干。",
        "不要忘了给我们的老板写报告。",
        "那匹马跑到山坡上面去了。",
        "冰箱里没有牛奶,也没有面条。",
    ),
}
"""Lines of everyday words with many bilabials, by voice of espeak-ng."""


class Take(NamedTuple):
    """A recording with what is said."""

    group: str
    waveform: Float32
    phones: Phones
    text: str
    language: str


def recorded(folder: Path, split: str, most: int | None) -> list[Take]:
    """English recordings of people with phones and a transcript, evenly spread in each group.

    Raises
    ------
    DataError
        If there is none.
    """
    clips = {c.audio: c for c in read_clips(folder, split) if c.source == "recording" and c.phones}
    frame = pd.read_csv(folder / "clips.csv", dtype=str, keep_default_na=False)
    rows = {row["clip"]: row for row in frame.to_dict("records")}
    groups = defaultdict(list)
    for clip in clips.values():
        row = rows[clip.name]
        age = row.get("age", "")
        kind = "" if not age.isdecimal() else " adults" if int(age) >= 16 else " children"
        if row.get("transcript"):
            groups[clip.speaker.split(":")[0] + kind].append((clip, row["transcript"]))
    if not groups:
        raise DataError(f"{folder}: the split {split!r} has no transcript with phones")
    takes = []
    for name, group in groups.items():
        places = np.linspace(0, len(group) - 1, min(most or len(group), len(group)))
        for clip, text in (group[i] for i in places.round().astype(int)):
            assert clip.phones is not None
            sound = load_audio(clip.audio).waveform
            takes.append(Take(name, sound, read_phones(clip.phones), text, "en-us"))
    return takes


def spoken() -> Iterator[Take]:
    """The lines of espeak-ng, with its times."""
    for language, lines in LINES.items():
        for variant in VOICES:
            for text in lines:
                said = espeak.synthesise(text, voice=language, variant=variant, language=language)
                phones = [(p.start, p.end, p.name) for p in said.phones]
                yield Take(f"espeak-ng {language}", said.waveform, phones, text, language)


def exchanged(words: Transcript, others: Transcript, every: int = 4) -> Transcript:
    """`words` with every `every`-th one from `others`."""
    mixed: list[Word] = [
        others.words[i % len(others.words)] if i % every == every - 1 else word
        for i, word in enumerate(words.words)
    ]
    return Transcript(tuple(mixed), "exchanged")


def measure(
    network: CurveNetwork, takes: Sequence[Take]
) -> dict[str, dict[str, list[ClosureScores]]]:
    """Closures of every group and condition, clip by clip."""
    still = Acting.of(life="off")
    said = [Transcript.of(take.text, take.language) for take in takes]
    found: dict[str, dict[str, list[ClosureScores]]] = defaultdict(lambda: defaultdict(list))
    for i, take in enumerate(takes):
        other = said[(i + len(takes) // 2) % len(takes)]
        given = (None, said[i], other, exchanged(said[i], other))
        prepared = prepare(take.waveform, still, lambda: network, sample_rate=16_000)
        reading = prepared.read()
        evidence, prior = measure_phones(prepared.speech), phone_evidence().weights["prior"]
        for name, words in zip(CONDITIONS, given, strict=True):
            neutral = reading.neutral.copy()
            copy = reading._replace(neutral=neutral, emotional=neutral)
            fit = None if words is None else fit_words(evidence, words, prior)
            curves = finish(prepared, copy, words=fit).curves.values
            lips = lips_together(curves, network.controls)
            found[take.group][name].append(closure_scores(lips, take.phones))
    return found


def summary(found: dict[str, dict[str, list[ClosureScores]]]) -> dict[str, dict[str, float]]:
    """Share of the bilabials found by group and condition, and their number."""
    groups: dict[str, dict[str, float]] = {}
    for group, rows in found.items():
        scores = {name: summarise_closures(clips) for name, clips in rows.items()}
        groups[group] = {name: score.hit_rate for name, score in scores.items()}
        groups[group]["bilabials"] = next(iter(scores.values())).n_closures
    return groups


def as_markdown(found: dict[str, dict[str, list[ClosureScores]]]) -> str:
    """Bilabials found, one column for each group."""
    columns = {
        group: {n: f"{v:d}" if isinstance(v, int) else f"{v:.3f}" for n, v in scores.items()}
        for group, scores in summary(found).items()
    }
    return "\n".join(table("bilabials found", columns)) + "\n"


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="dataset folder with phones")
    parser.add_argument("--model", default="default", help="name or folder")
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--most", type=int, help="most recordings of a group")
    parser.add_argument("--json", type=new_file, help="also write the report to this file")
    options = parser.parse_args(arguments)
    network = load_network(options.model)
    found = measure(network, recorded(options.data, options.split, options.most))
    found |= measure(network, list(spoken()))
    sys.stdout.write(as_markdown(found))
    known = identified(options.model) | {"split": options.split}
    write_json(options.json, known | {"groups": summary(found)})


if __name__ == "__main__":
    sys.exit(main())
