"""One voice that has not ended: its sound, its acting, and the frames that it gives.

Letters: S samples, n frames of a call, P spectra a frame, W samples of a spectrum, C controls.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deitalk.acting import Acting
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.voice_activity import WINDOW
from deitalk.emotions import EmotionTrack
from deitalk.models.protocol import SpectraGrid
from deitalk.postprocess.edges import Edge
from deitalk.postprocess.gates import fade
from deitalk.postprocess.joins import MOST_HEAD_FRAMES, Passage
from deitalk.postprocess.life.character import Seeds, Traits
from deitalk.postprocess.variants import choose_ways
from rig import ControlSet
from rig.arrays import Float32, Int64
from rig.curves import HEAD
from rig.curves.edit import gain_factors

CLOSING_FRAMES, OPENING_FRAMES = 3, 5
"""Frames in which the mouth of a voice that is interrupted shuts: a tenth of a second; and over
which it may open again for the sound that comes then."""
RAMP_SECONDS = 0.2
"""Time over which one emotion, or intensity, passes into the next."""


class Change(NamedTuple):
    """Emotion and intensity from a time of the sound on."""

    seconds: float
    emotion: EmotionTrack
    intensity: float


class Sound:
    """The last samples of a stream at 16 kHz."""

    def __init__(self) -> None:
        self.samples, self.begin, self.end = np.zeros(0, np.float32), 0, 0
        """The last ones, the number of the first of them, and how many have come."""

    def append(self, samples: Float32) -> None:
        """Take the next samples."""
        self.samples = np.concatenate((self.samples, samples))
        self.end += samples.size

    def windows(self, starts: Int64, size: int) -> Float32:
        """`size` samples from each start on [shape=(..., n, size)]; silence before the first."""
        first = int(starts[0])
        piece = self.samples[..., max(first - self.begin, 0) :]
        if first < 0:
            silence = np.zeros((*piece.shape[:-1], -first), np.float32)
            piece = np.concatenate((silence, piece), axis=-1)
        rows: Float32 = piece[..., (starts - first)[:, None] + np.arange(size)]
        return rows

    @classmethod
    def together(cls, sounds: Sequence["Sound"]) -> "Sound":
        """Put sounds of equal length side by side."""
        one = cls()
        one.samples = np.array([sound.samples for sound in sounds])
        one.begin, one.end = sounds[0].begin, sounds[0].end
        return one

    def drop(self, before: int) -> None:
        """Drop samples before a place."""
        if before - self.begin > SAMPLE_RATE:
            self.samples = self.samples[before - self.begin :].copy()
            self.begin = before


class Stream:
    """Sound, acting and frames of one voice.

    Parameters
    ----------
    grid : SpectraGrid
        Of the network.
    controls : ControlSet
        Columns of the curves.
    acting : Acting
        At the start.
    moves : bool
        Whether blinks, gaze, brows, head and neck move.
    actor : array [shape=(A,)]
        Weights of the network's actors.
    """

    def __init__(
        self,
        grid: SpectraGrid,
        controls: ControlSet,
        acting: Acting,
        moves: bool,
        actor: Float32,
    ) -> None:
        self.grid, self.controls, self.moves = grid, controls, moves
        self.actor, self.rest = actor, b""
        self.other: Sound | None = None
        """Sound of the other speaker."""
        self.sound, self.changes = Sound(), [Change(0.0, acting.emotion_track, acting.intensity)]
        self.acting, self.gain = acting, gain_factors(controls, acting.gain)
        self.wanted = self._wanted()
        traits = Traits.of(Seeds((0, 0, acting.seed)).character())
        traits = replace(traits, own=float(actor.any()))
        self.ways = choose_ways(acting.variant, traits, acting.seed)
        self.groups = 0
        self.n_given = -grid.rules_ahead
        """Frame that the rules give next."""
        self.n_total: int | None = None
        self.frames: list[tuple[Float32, Float32]] = []
        """Frames that were finished and not collected, with their tracks of the head."""
        self.shut: tuple[int, int] | None = None
        """First frame of a mouth that is interrupted, and that of the sound that comes after."""
        self.shown = self.last = (controls.rest, np.zeros(len(HEAD), np.float32))
        """Frame and head that are on the screen when it is, and those that were given last."""
        self.passage: Passage | None = None

    def interrupt(self, silence: int, shown: tuple[Float32, Float32] | None) -> None:
        """Replace the sound from the next frame on by silence, as long as the look-ahead."""
        first = max(self.n_given, 0)
        sample = first * SAMPLE_RATE // FRAME_RATE - self.sound.begin
        samples = self.sound.samples.copy()
        samples[max(sample, 0) :] = 0
        self.sound.samples, self.rest = samples, b""
        self.sound.append(np.zeros(silence, np.float32))
        self.shut, self.shown = (first, frame_count(self.sound.end)), shown or self.last
        self.passage = None

    def mouth_share(self, count: int) -> Float32:
        """Share of the mouth's motion in the `count` frames that the rules give next."""
        if self.shut is None:
            return np.ones(count, np.float32)
        begin, end = self.shut
        frames = np.arange(self.n_given, self.n_given + count)
        falls = fade((frames - begin + 1) / CLOSING_FRAMES)
        rises = 1 - fade((frames - end + 1) / OPENING_FRAMES)
        return np.asarray(np.maximum(falls, rises), np.float32)

    def give(self, frames: Float32, heads: Float32, first: int) -> None:
        """Give the frames from number `first` on.

        After an interruption they begin in the frame that was shown: the expression stays until
        new sound comes.
        """
        if self.shut is not None and len(frames):
            begin, end = self.shut
            if self.passage is None:
                pose, head = (tuple(part.tolist()) for part in self.shown)
                names, still = self.controls.names, tuple(0.0 for _ in HEAD)
                edge = Edge(dict(zip(names, pose, strict=True)), {}, head, still)
                self.passage = Passage.of(
                    self.controls, edge, heads[0], MOST_HEAD_FRAMES,
                    mouth=CLOSING_FRAMES - 1, held=end - begin,
                )  # fmt: skip
            self.passage.mix(frames, heads, first - begin)
            if first + len(frames) >= begin + max(self.passage.n_frames, end - begin):
                self.passage = None
                self.shut = None if first + len(frames) >= end + OPENING_FRAMES else self.shut
        if len(frames):
            self.last = frames[-1], heads[-1]
        self.frames.append((frames, heads))

    def change(self, acting: Acting) -> None:
        """Change the acting of the sound that comes next; at once before any."""
        self.gain = gain_factors(self.controls, acting.gain)  # an error changes nothing
        before, self.acting = self.acting, acting
        change = Change(self.sound.end / SAMPLE_RATE, acting.emotion_track, acting.intensity)
        if (acting.emotion, acting.intensity) != (before.emotion, before.intensity):
            self.changes = [*self.changes, change] if self.sound.end else [change]
            self.wanted = self._wanted()

    def _wanted(self) -> tuple[Float32, float] | None:
        """Emotion (9,) and intensity of the last change; None if the emotion has keys."""
        last = self.changes[-1]
        return None if self.acting.is_keyed else (last.emotion.at([0.0])[0], last.intensity)

    def finish(self) -> None:
        """End the sound: silence follows it, until the last frame is known."""
        self.n_total = frame_count(self.sound.end)
        self.sound.append(np.zeros(round(1.5 * SAMPLE_RATE), np.float32))

    def n_ready(self) -> int:
        """Groups of spectra whose samples have come and that were not taken."""
        grid = self.grid
        if self.n_total is not None:
            return self.n_total + grid.rules_ahead + grid.delay - self.groups
        # centre of the last spectrum that is whole, and of the last frame that can be measured
        last = self.sound.end - (grid.length - grid.length // 2)
        frame = self.sound.end - (WINDOW - WINDOW // 2)
        spectra = int((last + 0.5) * grid.rate / SAMPLE_RATE) + 2 + grid.lead
        while spectra > 0 and round((spectra - 1 - grid.lead) * SAMPLE_RATE / grid.rate) > last:
            spectra -= 1
        frames = ((frame + 1) * FRAME_RATE - 1) // SAMPLE_RATE + 1
        return max(min(spectra // grid.spectra, frames) - self.groups, 0)

    def spectrum_starts(self, count: int) -> Int64:
        """First samples of the spectra of the next groups [shape=(count P,)]."""
        grid = self.grid
        index = np.arange(self.groups * grid.spectra, (self.groups + count) * grid.spectra)
        centres = np.round((index - grid.lead) * SAMPLE_RATE / grid.rate).astype(np.int64)
        return centres - grid.length // 2

    def measured_starts(self, count: int) -> Int64:
        """First samples of the frames of the next groups [shape=(count,)]."""
        frames = np.arange(self.groups, self.groups + count)
        starts: Int64 = frames * SAMPLE_RATE // FRAME_RATE - WINDOW // 2
        return starts

    def append_other(self, samples: Float32, begin: int) -> None:
        """Take sound of the other speaker, which begins with a sample of the own sound."""
        self.other = self.other or Sound()
        silent = max(begin - self.other.end, 0)
        self.other.append(np.concatenate((np.zeros(silent, np.float32), samples)))

    def other_windows(self, starts: Int64) -> Float32 | None:
        """Sound (n, `WINDOW`) of the other speaker, silence where none has come."""
        if self.other is None:
            return None
        self.append_other(np.zeros(0, np.float32), self.sound.end)
        windows = self.other.windows(starts, WINDOW)
        self.other.drop(int(starts[-1]))
        return windows

    def forget(self) -> None:
        """Drop sound and changes that no frame needs any more."""
        self.sound.drop(int(min(self.spectrum_starts(1)[0], self.measured_starts(1)[0])))
        seconds = (self.groups - self.grid.delay) / FRAME_RATE - RAMP_SECONDS
        while len(self.changes) > 1 and self.changes[1].seconds < seconds:
            self.changes.pop(0)

    def given(self, count: int) -> slice:
        """Select the frames of the stream among the `count` that the rules give next.

        None before the first one, `rules_ahead` behind the network's rows, and none after the last.
        """
        first = self.n_given
        self.n_given += count
        if first >= 0 and self.n_total is None:
            return slice(0, count)
        stop = self.n_given if self.n_total is None else min(self.n_given, self.n_total)
        late = min(max(-first, 0), count)
        return slice(late, max(stop - first, late))

    def collect(self) -> tuple[Float32, Float32]:
        """Frames since the last call [shape=(n, C)], and their track of the head [shape=(n, 6)]."""
        given, self.frames = self.frames, []
        if not given:
            return _none(len(self.controls)), _none(len(HEAD))
        frames, heads = given[0]
        if len(given) == 1:
            return frames.copy(), heads.copy()
        return np.concatenate([one for one, _ in given]), np.concatenate([one for _, one in given])

    def directed(self, count: int) -> tuple[Float32, Float32]:
        """Emotion (count, 9) and intensity (count,) of the acting in the next groups."""
        frames = np.arange(self.groups, self.groups + count) - self.grid.delay
        times = np.maximum(frames, 0) / FRAME_RATE
        first = self.changes[0]
        emotion = first.emotion.at(times)
        intensity = np.full(len(times), first.intensity, np.float32)
        for change in self.changes[1:]:
            share = np.clip((times - change.seconds) / RAMP_SECONDS, 0, 1).astype(np.float32)
            emotion = emotion + share[:, None] * (change.emotion.at(times) - emotion)
            intensity = intensity + share * (np.float32(change.intensity) - intensity)
        return emotion.astype(np.float32), intensity.astype(np.float32)


def _none(count: int) -> Float32:
    return np.zeros((0, count), np.float32)
