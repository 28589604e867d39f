"""Turn and shift of the head on the voice and while another one speaks.

- Nods on stressed syllables, deeper where level and pitch are high (Hadar et al. 1983; Munhall et
  al. 2004; Graf et al. 2002), lowering at the end of a phrase and a raise before the next one
  (McClave 2000), stillness in pauses, where the breath lifts head and shoulders a little.
- An emotion has a posture and a liveliness: sadness lowers and tilts the head, anger lowers and
  advances it, surprise and fear draw it back (Coulson 2004), disgust turns it away, contempt
  raises it (amounts of the moods by eye); motion is wider and faster in happiness and
  anger, and smaller in sadness, than in neutral speech (Busso et al. 2007).
- `NODS`, `SWAY` and `STIR` are set so that range and speed of a neutral take, and the correlation
  of its pitch with stressed syllables, are those of six readers on video (docs/life.md).

The track has six columns (`rig.curves.HEAD`): yaw to the character's right, pitch up, roll to the
right shoulder, degrees; then the shift in cm to the character's
left, up and forward, the axes of the embedded head.

Letters: T frames at 30 per second.
"""

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import LABELS, by_emotion
from deitalk.postprocess.life.draws import (
    Swells,
    UInt64,
    between,
    by_rank,
    followed,
    normals,
    smooth_noise,
    uniforms,
)
from deitalk.postprocess.life.neck import (
    INHALE,
    INHALE_LEAD,
    INHALE_SECONDS,
    LEAST_WAIT,
    SWALLOW,
    SWALLOW_EVERY,
    SWALLOW_PAUSE,
)
from deitalk.postprocess.life.voice import END, LISTENING_SECONDS, PAUSE, START, STRESS, Cues
from rig.arrays import Float32, Float64, Int64
from rig.curves import HEAD

NODS = (0.26, 1.8, 0.26)
"""Turn of a full nod, degrees: its pitch, and the standard deviation of its yaw and roll."""
NOD_SECONDS = ((0.13, 0.2), (0.15, 0.24))
"""Attack and decay."""
NOD_SPEED = 15.0
"""Degrees per second: a nod that would go down faster takes longer and is less deep. The fastest
moments of six readers' pitch are of 7 to 28 (mean 17)."""
NOD_LAG, NOD_SPREAD = 0.03, 0.015
"""Seconds from the peak of the syllable to the lowest point, and their standard deviation."""
NOD_SHARE, ASIDE_SHARE, UP_SHARE = (0.78, 0.2), 0.06, 0.05
"""Share of the stressed syllables with a nod: of the weakest, and more of the strongest. Of these
the share that turns or tilts the head instead (McClave 2000), and that raises it."""
TURN, TURN_SECONDS = ((2.2, 0.4, 0.5), (0.5, 0.4, 1.7)), ((0.35, 0.6), (0.5, 1.0))
"""Yaw, pitch and roll of a full turn and of a full tilt; attack and decay."""
MOST_ASIDE = 1.2
"""Height of the largest turn or tilt."""
VIGOUR, VIGOUR_SECONDS = 0.35, 1.6
"""A speaker moves the head in phases: standard deviation of the logarithm of the factor on nods and
slow turns, and the sigma of the Gaussian that its noise is smoothed with."""
LEAST_NOD, HIGH_NOD = 0.5, 0.3
"""Height of the nod of the weakest stress, and what a prominence of 1 adds to any."""
NOD_RAISE = 0.4
"""Pitch from which a speaker nods, degrees: about the mean of the nods."""
LISTENING_DEGREES = (0.8, 1.6)
"""Depth of single and double nods in long silence, `LISTENING_EVERY` apart (Dittmann and Llewellyn
1968)."""
SWAY, SWAY_SECONDS = (0.25, 0.7, 0.2), 0.7
STIR, STIR_SECONDS = (0.46, 0.28, 0.3), 0.14
"""Standard deviation of slow and of quick turns, yaw, pitch and roll in degrees, and the sigma of
the Gaussian that their noise is smoothed with."""
QUIET = 0.5
"""Share of the sway that is left in a pause."""
FINAL_DEGREES, INITIAL_DEGREES = -0.8, 0.5
"""Pitch at the end and before the start of a phrase."""
FINAL_SECONDS, INITIAL_SECONDS = (1.0, 0.1, 1.2), (0.6, 0.0, 0.8)
"""Attack, hold and decay."""
LATE_SECONDS = 0.4
"""Attack of the lowering where the end of a phrase is known late."""
INITIAL_LEAD, LIFT_LEAD = 0.2, 0.05
"""The raise and the breath are highest so long before a phrase, seconds."""
INHALE_AFTER, READY_AFTER = 0.6, 0.9
"""Seconds of a pause whose end is not known after which the breath is drawn and the head raised."""
BREATH_SECONDS, BREATH_CM, BREATH_DEGREES = 4.0, 0.05, 0.15
"""Period of quiet breathing, its lift, and the pitch that goes with it."""
INHALE_PAUSE, INHALE_CM, INHALE_DEGREES = 0.3, 0.14, 0.35
"""The same in a pause of at least 0.3 s before a phrase."""
LIFT_SECONDS = (0.35, 0.0, 1.2)
SHIFT_CM, SHIFT_SECONDS = (0.07, 0.05, 0.1), 0.8
POSTURE: dict[str, tuple[float, ...]] = {
    "neutral": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "angry": (0.0, -3.0, 0.0, 0.0, -0.1, 0.8),
    "happy": (0.0, 1.0, 1.5, 0.0, 0.1, 0.1),
    "sad": (0.0, -4.5, 2.5, 0.0, -0.3, -0.1),
    "surprised": (0.0, 2.5, 0.0, 0.0, 0.15, -0.7),
    "fear": (0.0, -1.0, 0.0, 0.0, -0.2, -1.0),
    "disgust": (4.0, 1.5, -1.5, 0.0, 0.0, -0.6),
    "contempt": (3.0, 3.5, 2.5, 0.0, 0.1, -0.3),
    "calm": (0.0, 0.0, 1.0, 0.0, -0.05, 0.0),
}
"""Held turn and shift of an emotion at intensity 1; its roll goes to the character's own side."""
LIVELINESS = {"neutral": 1.0, "angry": 1.35, "happy": 1.4, "sad": 0.85, "surprised": 1.25,
              "fear": 0.8, "disgust": 0.9, "contempt": 0.7, "calm": 0.5}  # fmt: skip
_POSTURES = by_emotion(POSTURE)
_LIVELY = np.array([LIVELINESS.get(name, 1.0) for name in LABELS])
POSTURE_SECONDS = 0.35
"""Over which a posture, and the raise of speech, come and go."""
POSTURE_SHARE = 1.4 / (POSTURE_SECONDS * FRAME_RATE)
"""Share of a frame in each of the two filters of the posture."""
QUIET_BREATH = 0.13
"""Breath of the neck in silence, on the average."""
PITCH, UP, BREATH, SWALLOWS = 1, 4, 6, 7
CHANNELS = 8
"""The columns of `rig.curves.HEAD`, breath and swallowing of the neck."""


LISTENER_SHARE, LISTENER_LEAD = 0.75, 0.25
"""Share of the ends of another one's phrases at which a listener nods, and seconds to the first
nod's lowest point."""
LISTENER_DEGREES, LISTENER_SECONDS = (1.8, 3.6), (0.22, 0.0, 0.30)
"""Depth of its first nod, of which each further one has `LISTENER_DECAY`; attack, hold, decay."""
LISTENER_DECAY, LISTENER_BEAT, LISTENER_MOST = 0.65, 0.42, 3
"""Nods come in one to three, so many seconds apart (Hadar, Steiner and Rose 1985)."""


def draw_nods(
    strength: Float64, prominence: Float64, vigour: Float64, shares: Float64
) -> tuple[Float64, Float64, Float64, Float64]:
    """Draw the nods of stressed syllables.

    Parameters
    ----------
    strength : array [shape=(N,), range 0 to 1]
        Of the stress.
    prominence : array [shape=(N,)]
        Level and pitch of the syllable, as in `deitalk.postprocess.life.voice.Voice`.
    vigour : array [shape=(N,)]
        Factor on the depth.
    shares : array [shape=(N, 10)]
        Uniform numbers.

    Returns
    -------
    lag, attack, decay : array [shape=(N,)]
        Seconds from the peak of the syllable to the lowest point, down and up: longer where the nod
        would be faster than `NOD_SPEED`, and less deep.
    degrees : array [shape=(N, 3)]
        Yaw, pitch and roll at the lowest point; 0 where the syllable has no nod.
    """
    lag = NOD_LAG + NOD_SPREAD * normals(shares[:, 0])
    height = LEAST_NOD + (1 - LEAST_NOD) * strength
    height *= (1 + HIGH_NOD * np.clip(prominence, 0, 2)) * between(shares[:, 1], (0.5, 1.5))
    height *= shares[:, 2] < NOD_SHARE[0] + NOD_SHARE[1] * strength
    kind, sign = shares[:, 5], np.where(shares[:, 8] < 0.5, 1.0, -1.0)
    is_aside = kind < ASIDE_SHARE
    attack, decay = (
        between(share, span) + is_aside * (between(share, slow) - between(share, span))
        for share, span, slow in zip(shares.T[3:5], NOD_SECONDS, TURN_SECONDS, strict=True)
    )
    turn = np.array(TURN)[(kind < ASIDE_SHARE / 2).astype(int)]
    aside = turn * np.stack((sign, -np.ones(len(sign)), sign), axis=1)
    aside /= np.maximum(height / MOST_ASIDE, 1)[:, None]
    up = np.where(kind > 1 - UP_SHARE, 0.7, -1.0)
    sides = normals(shares[:, 6:8])
    nod = np.array(NODS) * np.stack((sides[:, 0], up, sides[:, 1]), axis=1)
    degrees = (vigour * height)[:, None] * np.where(is_aside[:, None], aside, nod)
    slower = np.maximum(0.5 * np.pi * np.abs(degrees[:, 1]) / attack / NOD_SPEED, 1) ** 0.5
    return lag, slower * attack, slower * decay, degrees / slower[:, None]


class Head:
    """Motion of the heads and necks of streams, and the posture beneath it.

    Parameters
    ----------
    keys : array of uint64 [shape=(B,)]
        Equal keys give equal motion.
    side, ranges : array [shape=(B,)]
        How much stronger the left side moves; factor on the motion.
    """

    def __init__(self, keys: UInt64, side: Float64, ranges: Float64) -> None:
        self.keys, self.side, self.ranges = keys, side, ranges
        self.swells = Swells(CHANNELS)
        self.spread = np.array([*SWAY, *STIR, *SHIFT_CM, 0.6, VIGOUR])
        seconds = [SWAY_SECONDS] * 3 + [STIR_SECONDS] * 3 + [SHIFT_SECONDS] * 3
        self.seconds = np.array([*seconds, 1.5, VIGOUR_SECONDS])
        self.phase = 2 * np.pi * uniforms(keys, np.full(len(keys), -1), 1)[:, 0]
        self.swallow = self._wait(np.arange(len(keys)), np.full(len(keys), -2.0), SWALLOW_EVERY)
        """Seconds of the next one."""
        self.held = np.zeros((len(keys), len(HEAD), 2))
        """State of the filter of the posture."""

    def reset(self, stream: int) -> None:
        """Begin a stream again."""
        self.swells.clear(stream)
        one = np.array([stream])
        self.phase[stream] = 2 * np.pi * uniforms(self.keys[one], np.array([-1]), 1)[0, 0]
        self.swallow[stream] = self._wait(one, np.array([-2.0]), SWALLOW_EVERY)[0]
        self.held[stream] = 0

    def _wait(self, streams: Int64, places: Float64, mean: float) -> Float64:
        """Exponential waits of some places, seconds."""
        waits: Float64 = -mean * np.log(uniforms(self.keys[streams], places, 1)[:, 0])
        return waits

    def cue(self, cues: Cues) -> None:
        """Begin the motion of syllables, of the ends of phrases, and of pauses."""
        self._nods(cues.where(cues.kind == STRESS))
        starts = cues.where((cues.kind == START) & ~np.isnan(cues.stop))
        attack, hold, decay = INITIAL_SECONDS
        shorter = np.minimum(decay, starts.size / 2)
        self._pitch(starts, starts.time - INITIAL_LEAD, (attack, hold, shorter), INITIAL_DEGREES)
        ends = cues.where(cues.kind == END)
        attack, hold, decay = FINAL_SECONDS
        lowered = np.where(ends.is_question, -0.5 * FINAL_DEGREES, FINAL_DEGREES)
        shorter = np.minimum(attack, ends.size / 2)
        self._pitch(ends, ends.time, (shorter, hold, decay), lowered, LATE_SECONDS)
        self._pauses(cues.where(cues.kind == PAUSE))

    def hear(self, cues: Cues) -> None:
        """Nod at the ends of another one's phrases."""
        ends = cues.where(cues.kind == END)
        shares = self._shares(ends, ends.time)
        depth = -between(shares[:, 1], LISTENER_DEGREES) * (shares[:, 0] < LISTENER_SHARE)
        first = np.maximum(ends.time, ends.known) + LISTENER_LEAD + 0.2 * shares[:, 2]
        count = np.ceil(LISTENER_MOST * shares[:, 3])
        for beat in range(LISTENER_MOST):
            height = depth * LISTENER_DECAY**beat * (beat < count)
            self._pitch(ends, first + beat * LISTENER_BEAT, LISTENER_SECONDS, height)

    def _shares(self, cues: Cues, times: Float64) -> Float64:
        return uniforms(self.keys[cues.stream], np.round(times * FRAME_RATE), 10)

    def _pitch(
        self,
        cues: Cues,
        peak: Float64,
        seconds: "tuple[Float64 | float, float, Float64 | float]",
        degrees: Float64 | float,
        shortest: float | None = None,
        channel: int = PITCH,
    ) -> None:
        """Add swells of one channel, the pitch."""
        heights = np.zeros((len(peak), CHANNELS))
        heights[:, channel] = degrees
        self.swells.add(cues.stream, peak, seconds, heights, cues.known, shortest)

    def _nods(self, cues: Cues) -> None:
        keys = self.keys[cues.stream]
        noise = smooth_noise(keys, cues.time[:, None], self.spread, self.seconds)
        vigour = np.exp(noise[:, 0, -1])
        shares = self._shares(cues, cues.time)
        lag, attack, decay, degrees = draw_nods(cues.size, cues.prominence, vigour, shares)
        heights = np.pad(degrees, ((0, 0), (0, CHANNELS - 3)))
        self.swells.add(cues.stream, cues.time + lag, (attack, 0.0, decay), heights, cues.known)

    def _pauses(self, cues: Cues) -> None:
        """Breath and raise before the next phrase, a swallow, nods in long silence."""
        to_come = np.isnan(cues.stop)
        breath = cues.where(cues.size == np.where(to_come, INHALE_AFTER, INHALE_PAUSE))
        lift = breath.before_next(LIFT_LEAD, INHALE_AFTER + LIFT_SECONDS[0])
        top = breath.before_next(INHALE_LEAD, INHALE_AFTER + INHALE_SECONDS[0])
        follows = ~np.isnan(lift)
        breath, lift, top = breath.where(follows), lift[follows], top[follows]
        self._pitch(breath, lift, LIFT_SECONDS, INHALE_DEGREES)
        self._pitch(breath, lift, LIFT_SECONDS, INHALE_CM, channel=UP)
        self._pitch(breath, top, INHALE_SECONDS, INHALE, channel=BREATH)
        ready = cues.where(to_come & (cues.size == READY_AFTER))
        peak = ready.time + READY_AFTER + INITIAL_SECONDS[0]
        self._pitch(ready, peak, INITIAL_SECONDS, INITIAL_DEGREES)
        self._swallows(cues.where(cues.size >= SWALLOW_PAUSE))
        silent = cues.where(cues.size >= LISTENING_SECONDS)
        shares = self._shares(silent, silent.time + silent.size)
        for beat in (0, 1):
            time = silent.time + silent.size + 2 * shares[:, 0] + 0.45 * beat
            depth = -between(shares[:, 2 + beat], LISTENING_DEGREES)
            nods = (shares[:, 1] < 0.5) | (beat == 0)
            nods &= ~(time >= silent.stop - 1)
            self._pitch(silent.where(nods), time[nods], (0.25, 0.0, 0.35), depth[nods])

    def _swallows(self, cues: Cues) -> None:
        for rank in by_rank(cues.stream):
            part = cues.where(rank)
            wanted = self.swallow[part.stream] - 0.5
            begin = np.maximum(np.maximum(part.known, part.time), wanted)
            to_come = np.isnan(part.stop)
            due = np.where(to_come, begin == part.known, part.stop - begin >= SWALLOW_PAUSE)
            part, begin = part.where(due), begin[due]
            self._pitch(part, begin + 0.5, SWALLOW, 1.0, channel=SWALLOWS)
            places = np.round(begin * FRAME_RATE) + (1 << 40)
            wait = self._wait(part.stream, places, SWALLOW_EVERY - LEAST_WAIT)
            self.swallow[part.stream] = begin + LEAST_WAIT + wait

    def play(self, streams: Int64, first: Int64, speaks: Float64) -> Float64:
        """Motion of the next frames of some streams on neutral faces [shape=(B, n, `CHANNELS`)].

        `speaks` [shape=(B, n), range 0 to 1] is how far the face speaks.
        """
        count = speaks.shape[1]
        total = self.swells.play(streams, first, count)
        times = (first[:, None] + np.arange(count)) / FRAME_RATE
        noise = smooth_noise(self.keys[streams], times, self.spread, self.seconds)
        lively = QUIET + (1 - QUIET) * speaks[..., None]
        total[..., :3] += (np.exp(noise[..., 10:]) * noise[..., :3] + noise[..., 3:6]) * lively
        total[..., 3:6] += noise[..., 6:9]
        phase = self.phase[streams, None] + 2 * np.pi * times / BREATH_SECONDS
        quiet = np.sin(phase + noise[..., 9]) * (1 - 0.7 * speaks)
        total[..., UP] += BREATH_CM * quiet
        total[..., PITCH] += BREATH_DEGREES * quiet + NOD_RAISE * speaks
        total[..., BREATH] += QUIET_BREATH * (1 - speaks) * (1 + quiet)
        total[..., SWALLOWS] *= 1 - speaks
        return total

    def _wanted(self, streams: Int64, mixture: Float32) -> Float64:
        side = np.ones((len(streams), 1, len(HEAD)))
        side[:, 0, 2] = np.where(self.side[streams] >= 0, 1, -1)
        wanted: Float64 = mixture @ _POSTURES * side
        return wanted

    def settle(self, streams: Int64, mixture: Float32) -> None:
        """Begin streams in the posture of an emotion [shape=(B, 1, S)]."""
        wanted = (1 - POSTURE_SHARE) * self._wanted(streams, mixture)[:, 0]
        self.held[streams] = wanted[..., None]

    def postures(self, streams: Int64, mixture: Float32) -> Float64:
        """Posture of the emotion in the next frames [shape=(B, n, 6)], which comes and goes slowly.

        `mixture` [shape=(B, n, S)] is the emotion shown: weights times intensity.
        """
        wanted = self._wanted(streams, mixture)
        near, held = np.moveaxis(self.held[streams], -1, 0)
        near, held = near[:, None], held[:, None]
        rows, near = followed(wanted, POSTURE_SHARE, near)
        rows, held = followed(rows, POSTURE_SHARE, held)
        self.held[streams] = np.stack((near[:, 0], held[:, 0]), axis=-1)
        return rows

    def liveliness(self, streams: Int64, mixture: Float32) -> Float64:
        """Factor on the motion [shape=(B, n)]: of the emotion shown, and of the character."""
        calm = np.maximum(1 - mixture[..., 1:].sum(axis=-1), 0)
        factor: Float64 = (calm + mixture[..., 1:] @ _LIVELY[1:]) * self.ranges[streams, None]
        return factor
