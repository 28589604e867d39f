"""Forced alignment: the times of known phones in a recording, and how well the sound fits them.

The chain of phones, with an optional pause before each word, is laid through the evidence by
`best_path`. Times are the sound's: given times only bound where a word may
lie. A word fits as far as the evidence for its phones comes near that for the most probable ones;
words that the sound contradicts are reported and not used.

Letters: R rows of evidence, P phones, N states.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.errors import DataError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.transcript import Transcript, Word
from deitalk.postprocess.known_phones import KnownPhone
from deitalk.postprocess.phones import BILABIALS, PHONES, SILENCE, WIDEN_FRAMES
from rig import RigCurves, read_curves
from rig.arrays import Bool, Float32, Float64, Int64
from rig.controls import DEFAULT_ID
from rig.validation.findings import Finding

PRIOR_POWER = 0.6
"""Of the phones' frequency, by which the evidence is divided, so that rare phones are found too."""
FLOOR = -12.0
"""Least logarithm of a probability on the path: one bad row does not bend it."""
WORST = -6.0
"""Least fit of a row."""
LEAST_FIT = -1.4
"""Mean fit of a recording below which its words are not used."""
LEAST_WORD = -3.0
"""The same of one word."""
SLACK_SECONDS = 0.1
"""By which a phone may lie outside its word's given times."""
_SILENCE = PHONES.index(SILENCE)


@dataclass(frozen=True)
class FittedWord:
    """A word with its times in the sound.

    Attributes
    ----------
    text : str
        As written.
    start, end : float
        Seconds.
    fit : float
        Mean over its time of the logarithm of its phones' probability over the best phones'; 0 is
        the best.
    """

    text: str
    start: float
    end: float
    fit: float

    @property
    def fits(self) -> bool:
        """Whether the sound does not contradict it."""
        return self.fit >= LEAST_WORD


@dataclass(frozen=True)
class WordFit:
    """How the words of a transcript lie in a recording.

    Attributes
    ----------
    words : tuple of FittedWord
        Empty if there is no path through the recording.
    phones : tuple of KnownPhone
        All phones with their times.
    fit : float
        Mean over the speech; 0 is the best.
    is_bounded : bool
        Whether given times bounded the words; where nothing fits within them they are not used.
    """

    words: tuple[FittedWord, ...]
    phones: tuple[KnownPhone, ...]
    fit: float
    is_bounded: bool = False

    @property
    def is_used(self) -> bool:
        """Whether the sound fits the words as a whole."""
        return self.fit >= LEAST_FIT

    @property
    def fits(self) -> bool:
        """Whether the sound contradicts no word."""
        return self.is_used and all(word.fits for word in self.words)

    @property
    def known(self) -> tuple[KnownPhone, ...]:
        """Phones that the curves shall meet: those of words that fit."""
        return tuple(phone for phone in self.phones if phone.is_known) if self.is_used else ()

    @property
    def line(self) -> str:
        """One line: how well the words fit, and which do not."""
        if not self.is_used:
            score = f"score {self.fit:.2f}, at least {LEAST_FIT:g}" if self.words else "too many"
            return f"the words do not fit the sound ({score}); they are not used"
        wrong = [word.text for word in self.words if not word.fits]
        found = f"the words fit the sound (score {self.fit:.2f})"
        if not wrong:
            return found
        named = ", ".join(wrong[:5]) + (" …" if len(wrong) > 5 else "")
        return f"{found}; {len(wrong)} of {len(self.words)} do not and are not used: {named}"


def align_words(speech: Speech, transcript: Transcript) -> WordFit:
    """Times of a transcript's phones in a recording.

    Parameters
    ----------
    speech : Speech
        The recording.
    transcript : Transcript
        Its words.
    """
    return fit_words(measure_phones(speech), transcript, phone_evidence().weights["prior"])


def fit_words(evidence: Float32, transcript: Transcript, prior: Float32) -> WordFit:
    """`align_words` on evidence.

    Parameters
    ----------
    evidence : array [shape=(R, P)]
        Logarithm of each phone's probability, `RATE` rows a second.
    transcript : Transcript
        Words.
    prior : array [shape=(P,)]
        Share of each phone in speech.
    """
    states, owners = _chain(transcript.words)
    optional = states == _SILENCE
    weighed = np.maximum(evidence, FLOOR) - np.float32(PRIOR_POWER) * np.log(prior)
    spans = _spans(transcript.words, owners, len(evidence))
    path, is_bounded = np.zeros(0, np.int64), False
    if spans is not None:
        path, _ = best_path(weighed, states, optional, spans)
        is_bounded = bool(len(path))
    if not len(path):
        path, _ = best_path(weighed, states, optional)
    if not len(path):
        return WordFit((), (), -np.inf)
    return _fitted(evidence, transcript.words, states, owners, path, is_bounded)


def _chain(words: tuple[Word, ...]) -> tuple[Int64, Int64]:
    """Phone and word of each state [shape=(N,)]; pauses, before each word and last, are of -1."""
    states, owners = [], []
    for number, word in enumerate(words):
        states += [_SILENCE, *(PHONES.index(phone) for phone in word.phones)]
        owners += [-1, *(number for _ in word.phones)]
    return np.array([*states, _SILENCE], np.int64), np.array([*owners, -1], np.int64)


def _spans(words: tuple[Word, ...], owners: Int64, n_rows: int) -> Int64 | None:
    """Rows that each state may have [shape=(N, 2)]; None without given times."""
    if all(word.start is None for word in words):
        return None
    spans = np.tile(np.array([0, n_rows]), (len(owners), 1))
    for state, number in enumerate(owners.tolist()):
        word = words[number]
        if number >= 0 and word.start is not None and word.end is not None:
            first = int(np.floor((word.start - SLACK_SECONDS) * RATE))
            spans[state] = (first, int(np.ceil((word.end + SLACK_SECONDS) * RATE)) + 1)
    return spans


def _fitted(
    evidence: Float32,
    words: tuple[Word, ...],
    states: Int64,
    owners: Int64,
    path: Int64,
    is_bounded: bool,
) -> WordFit:
    """Times and fits of a path [shape=(R,)]."""
    chosen = states[path]
    best = evidence.max(axis=1)
    fits = np.maximum(evidence[np.arange(len(path)), chosen] - best, WORST)
    speaking = (chosen != _SILENCE) | (evidence[:, _SILENCE] < best)
    owner = owners[path]
    found = []
    for number, word in enumerate(words):
        rows = np.flatnonzero(owner == number)
        times = float(rows[0]) / RATE, float(rows[-1] + 1) / RATE
        found.append(FittedWord(word.text, *times, float(fits[rows].mean())))
    edges = np.flatnonzero(np.diff(path)) + 1
    pieces = zip([0, *edges.tolist()], [*edges.tolist(), len(path)], strict=True)
    phones = tuple(
        KnownPhone(
            first / RATE,
            stop / RATE,
            PHONES[chosen[first]],
            owner[first] < 0 or found[owner[first]].fits,
        )
        for first, stop in pieces
    )
    mean = float(fits[speaking].mean()) if speaking.any() else -np.inf
    return WordFit(tuple(found), phones, mean, is_bounded)


# The best path of a chain of phones through a recording (Viterbi 1967), with optional pauses.
#
# Letters: R rows of evidence, P phones, N states.


BAND = 400
"""States on both sides of the best one that are followed: about half a minute of speech. An hour of
speech takes 170 MB."""


def best_path(
    evidence: Float32, states: Int64, optional: Bool, spans: Int64 | None = None
) -> tuple[Int64, float]:
    """State of each row, from the first state to the last.

    Parameters
    ----------
    evidence : array [shape=(R, P)]
        Logarithms: how well each phone fits each row.
    states : array [shape=(N,)]
        Phone of each state, in their order.
    optional : array [shape=(N,)]
        Whether a state may be left out; neighbours never both.
    spans : array [shape=(N, 2)], optional
        First row, and row after the last, that a state may have.

    Returns
    -------
    path : array [shape=(R,)]
        Rises by 1, or by 2 over an optional state; empty if there is no path.
    score : float
        Sum of the evidence.
    """
    n_rows, n_states = len(evidence), len(states)
    score = np.full(n_states, -np.inf)
    lows, moves = np.zeros(n_rows, np.int64), []
    low, high = 0, min(n_states, BAND)
    score[:2] = np.where(np.arange(2) <= int(optional[0]), 0.0, -np.inf)[:n_states]
    for row in range(n_rows):
        if row:
            best = low + int(score[low:high].argmax())
            low, high = max(low, best - BAND), max(high, min(n_states, best + BAND))
            score[:low] = -np.inf
            score[low:high], move = _advanced(score, optional, low, high)
        else:
            move = np.zeros(high - low, np.int8)
        score[low:high] += evidence[row, states[low:high]]
        if spans is not None:
            outside = (row < spans[low:high, 0]) | (row >= spans[low:high, 1])
            score[low:high][outside] = -np.inf
        lows[row] = low
        moves.append(move)
    last = n_states - 1 - int(optional[-1] and n_states > 1 and score[-2] > score[-1])
    if not np.isfinite(score[last]):
        return np.zeros(0, np.int64), -np.inf
    return _traced(lows, moves, last), float(score[last])


def _advanced(score: Float64, optional: Bool, low: int, high: int) -> tuple[Float64, np.ndarray]:
    """Best scores of the next row, and by how many states each was entered."""
    padded = np.concatenate((np.full(2, -np.inf), score[max(low - 2, 0) : high]))
    padded = padded[-(high - low + 2) :]
    stay, one, two = padded[2:], padded[1:-1], padded[:-2].copy()
    before = np.zeros(high - low, bool)
    start = max(low, 1)
    before[start - low :] = optional[start - 1 : high - 1]
    two[~before] = -np.inf
    move = (one > stay).astype(np.int8)
    best = np.where(move, one, stay)
    skips = two > best
    move[skips] = 2
    return np.where(skips, two, best), move


def _traced(lows: Int64, moves: list[np.ndarray], last: int) -> Int64:
    path = np.empty(len(moves), np.int64)
    state = last
    for row in range(len(moves) - 1, -1, -1):
        path[row] = state
        state -= int(moves[row][state - lows[row]])
    return path


# Evidence for phones in a recording: how probable each is at each moment.
#
# A linear map of the speech features of `default`, fitted to phone times of the training corpus.
# Features are computed twice, the second time half a
# frame later, so that there are 60 rows per second: a phone may last 30 ms. The phones are classes
# of articulation (`deitalk.pipeline.words.transcript`), which all languages share.
#
# Letters: T frames at 30 per second, D features, P phones.


MODEL = "default"
"""Whose features the map was fitted to."""
WEIGHTS = "phone_evidence.safetensors"
RATE = 2 * FRAME_RATE
"""Rows per second."""
CONTEXT = (-3, 0, 3)
"""Rows beside each that the map reads too; the ends repeat."""
PIECE = 4096
"""Rows that are mapped at once: an hour has 216,000."""


class PhoneEvidence:
    """Speech features to probabilities of phones: multinomial logistic regression.

    Parameters
    ----------
    weights : mapping of str to array
        ``mean``, ``spread`` [shape=(D,)], ``weight`` [shape=(P, 3 D)], ``bias`` and ``prior``
        [shape=(P,)].
    """

    def __init__(self, weights: Mapping[str, Any]) -> None:
        self.weights = {name: np.asarray(w, np.float32) for name, w in weights.items()}

    def log_probabilities(self, features: Float32) -> Float32:
        """Logarithm of the probability of each phone [shape=(2 T, P)].

        Parameters
        ----------
        features : array [shape=(2 T, D)]
            From `phone_features`.
        """
        count = len(features)
        pieces = [np.arange(i, min(i + PIECE, count)) for i in range(0, count, PIECE)]
        parts = [self._piece(features, rows) for rows in pieces]
        return np.concatenate(parts) if parts else np.zeros((0, len(PHONES)), np.float32)

    def _piece(self, features: Float32, rows: Int64) -> Float32:
        """The same for some rows."""
        w, last = self.weights, len(features) - 1
        beside = [features[np.clip(rows + offset, 0, last)] for offset in CONTEXT]
        scaled = [(part - w["mean"]) / w["spread"] for part in beside]
        score = np.concatenate(scaled, axis=1) @ w["weight"].T + w["bias"]
        score -= score.max(axis=1, keepdims=True)
        score -= np.log(np.exp(score).sum(axis=1, keepdims=True))
        return np.asarray(score, np.float32)


def phone_features(network: DEITalk, speech: Speech) -> Float32:
    """Speech features of a recording at `RATE` [shape=(2 T, D)]."""
    sound, count = torch.tensor(speech.sound), speech.n_frames
    step = round(SAMPLE_RATE / RATE)
    later = sound[step:] if len(sound) > step else sound
    with torch.no_grad():
        both = [network.frontend.encode(part, count) for part in (sound, later)]
    return np.asarray(torch.stack(both, dim=1).flatten(0, 1).cpu().numpy(), np.float32)


def measure_phones(speech: Speech) -> Float32:
    """Logarithm of the probability of each phone, `RATE` rows a second [shape=(2 T, P)]."""
    features = phone_features(require_model(MODEL, DEITalk), speech)
    return phone_evidence().log_probabilities(features)


@lru_cache(maxsize=1)
def phone_evidence() -> PhoneEvidence:
    """The embedded map."""
    from safetensors.numpy import load

    data: Any = resources.files("deitalk.pipeline.words").joinpath(WEIGHTS).read_bytes()
    return PhoneEvidence(load(data))


# Closures that curves miss, by the words of the recording: ``deitalk validate --words``.

MET = 0.9
"""Least value of the lips-together controls of lips that meet."""
TAKE_SOUND, TAKE_CURVES = "audio.wav", "curves.csv"


def check_closures(path: Path, transcript: Transcript, audio: Path | None = None) -> list[Finding]:
    """Findings on the closures of a take, or of a file of curves with its recording.

    Parameters
    ----------
    path : Path
        Take folder, or a file of curves.
    transcript : Transcript
        What is said.
    audio : Path, optional
        The recording; by default that of the take.

    Returns
    -------
    list of Finding
        A note, or a warning where the words do not fit the sound; a warning for each p, b and m at
        which the lips do not meet.

    Raises
    ------
    DataError
        If there is no recording, or the curves have no lips-together controls.
    """
    curves_path = path / TAKE_CURVES if path.is_dir() else path
    if audio is None:
        audio = path / TAKE_SOUND if path.is_dir() else None
    if audio is None or not audio.is_file():
        raise DataError(f"{path}: no recording to compare the words with; name it")
    curves = read_curves(curves_path, control_set=DEFAULT_ID)
    fit = align_words(Speech.of(load_audio(audio).waveform), transcript)
    words = Finding("note" if fit.fits else "warning", curves_path, fit.line)
    return [words, *(Finding("warning", curves_path, t) for t in missed_closures(curves, fit))]


def missed_closures(curves: RigCurves, fit: WordFit) -> list[str]:
    """A line for each p, b and m at which the lips do not meet, within two frames at 30 Hz."""
    places = [i for i, name in enumerate(curves.names) if "lipsTogether" in name]
    if not places:
        raise DataError("the curves have no lips-together controls; convert them to the board")
    lips = curves.values[:, places].mean(axis=1)
    lines = []
    for phone in fit.known:
        if phone.name in BILABIALS:
            value = highest(lips, curves.fps, phone)
            if value < MET:
                lines.append(
                    f"{phone.start:.2f} s: the lips do not meet at {phone.name.lower()} of "
                    f"{_word(fit, phone)} ({value:.2f} of {MET:g})"
                )
    return lines


def highest(lips: Float32, fps: float, phone: KnownPhone) -> float:
    """Highest value within a phone widened by two frames at 30 Hz; 0 beyond the curves."""
    times = np.arange(len(lips)) / fps
    slack = WIDEN_FRAMES / FRAME_RATE + 1e-9
    window = lips[(times >= phone.start - slack) & (times <= phone.end + slack)]
    return float(window.max()) if len(window) else 0.0


def _word(fit: WordFit, phone: KnownPhone) -> str:
    """The word of a phone, in quotes."""
    middle = (phone.start + phone.end) / 2
    return next((repr(w.text) for w in fit.words if w.start <= middle < w.end), "a word")
