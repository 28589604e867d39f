"""festival, one process per batch of utterances: phone times within 12 to 26 ms."""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from deitalk.errors import AudioError, ConfigError, MissingError
from deitalk.research.corpus.engines.espeak import check_ranges
from deitalk.research.corpus.engines.flite import festival_to_phone
from deitalk.research.corpus.recordings import read_waveform
from deitalk.research.corpus.utterance import SAMPLE_RATE, Utterance, contiguous

PACKAGES = "festival festvox-us-slt-hts festvox-kallpc16k festvox-kdlpc16k"
MISSING = f"festival: the program festival is not on this machine; apt-get install {PACKAGES}"
VOICES = {
    "slt": "cmu_us_slt_arctic_hts",
    "kal": "kal_diphone",
    "ked": "ked_diphone",
}
"""Our name -> festival's. The statistical voice slt ignores stretch and pitch."""
TIMEOUT_SECONDS = 300


@dataclass(frozen=True)
class Job:
    """One utterance to synthesise.

    Attributes
    ----------
    text : str
        Plain English text.
    voice : str
        One of `VOICES`.
    stretch : float
        Factor on all durations, 0.3 to 4.
    f0_mean, f0_stddev : float
        Pitch in Hz, 40 to 500 and 0 to 150.
    style : str
        Emotion whose prosody the numbers above carry; kept in the utterance.
    """

    text: str
    voice: str = "slt"
    stretch: float = 1.0
    f0_mean: float = 105.0
    f0_stddev: float = 14.0
    style: str = "neutral"


@cache
def voices() -> tuple[str, ...]:
    """Names of `VOICES` that are installed."""
    if not shutil.which("festival"):
        return ()
    done = subprocess.run(
        ["festival", "--batch", "(print (voice.list))"],
        capture_output=True, text=True, timeout=TIMEOUT_SECONDS, check=False,
    )  # fmt: skip
    listed = set(done.stdout.replace("(", " ").replace(")", " ").split())
    return tuple(name for name, installed in VOICES.items() if installed in listed)


def missing() -> str | None:
    """Return None if festival works here, else the reason and the packages to install."""
    if not shutil.which("festival"):
        return MISSING
    return None if voices() else f"festival: no voice is installed; apt-get install {PACKAGES}"


def synthesise_batch(jobs: Sequence[Job]) -> list[Utterance | None]:
    """Synthesise many texts in one process.

    Parameters
    ----------
    jobs : sequence of Job
        Some 25: starting festival costs more than one utterance.

    Returns
    -------
    utterances : list of Utterance or None
        One per job; None where festival failed on the text.

    Raises
    ------
    ConfigError
        For an unknown voice or a number out of its range.
    MissingError
        If festival is not installed.
    """
    if reason := missing():
        raise MissingError(reason)
    for job in jobs:
        if job.voice not in voices():
            raise ConfigError(
                f"voice={job.voice!r} is not installed; installed: {', '.join(voices())}; "
                f"others: apt-get install {PACKAGES}"
            )
        check_ranges(stretch=(job.stretch, 0.3, 4), f0_mean=(job.f0_mean, 40, 500),
                     f0_stddev=(job.f0_stddev, 0, 150))  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = "\n".join(_commands(job, folder / str(i)) for i, job in enumerate(jobs))
        (folder / "batch.scm").write_text(script, encoding="latin-1", errors="replace")
        subprocess.run(
            ["festival", "--batch", str(folder / "batch.scm")],
            capture_output=True, timeout=TIMEOUT_SECONDS, check=False,
        )  # fmt: skip
        return [_utterance(job, folder / str(i)) for i, job in enumerate(jobs)]


def _commands(job: Job, stem: Path) -> str:
    """Scheme code of one job; an error in it does not end the batch."""
    text = job.text.replace("\\", " ").replace('"', " ").replace("\n", " ")
    return f"""(unwind-protect
 (begin
  (voice_{VOICES[job.voice]})
  (Parameter.set 'Duration_Stretch {job.stretch:g})
  (set! int_lr_params '((target_f0_mean {job.f0_mean:g}) (target_f0_std {job.f0_stddev:g})
                        (model_f0_mean 170) (model_f0_std 34)))
  (set! u (SynthText "{text}"))
  (utt.save.segs u "{stem}.lab")
  (utt.save.wave u "{stem}.wav"))
 nil)"""


def _utterance(job: Job, stem: Path) -> Utterance | None:
    """Utterance of the files of one job; None if there are none or only silence."""
    try:
        waveform = read_waveform(stem.with_suffix(".wav"))
        segments = parse_labels(stem.with_suffix(".lab").read_text(encoding="latin-1"))
    except (AudioError, OSError, ValueError):
        return None
    if all(name == "SIL" for *_, name in segments):
        return None
    return Utterance(
        waveform=waveform,
        phones=contiguous(segments, len(waveform) / SAMPLE_RATE),
        text=job.text,
        style=job.style,
        speaker=f"festival:{job.voice}",
        engine="festival",
        language="en",
    )


def parse_labels(labels: str) -> list[tuple[float, float, str]]:
    """Timed phones of a label file: a ``#`` line, then ``end colour phone`` lines.

    Parameters
    ----------
    labels : str
        Text of the file.

    Returns
    -------
    segments : list of (start, end, name)
        Seconds.
    """
    segments: list[tuple[float, float, str]] = []
    start = 0.0
    for line in labels.splitlines():
        fields = line.split()
        if len(fields) == 3:
            segments.append((start, float(fields[0]), festival_to_phone(fields[2])))
            start = float(fields[0])
    return segments
