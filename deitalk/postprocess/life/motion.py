"""Blinks, gaze, brows, head and neck of takes, or of voices that have not ended.

The times of all events come from the voice and the seed alone. What they move depends on the
emotion shown, which is 0 in the neutral reading: both readings blink and look alike, and intensity
0 gives the neutral reading with its motion.

Streams are side by side, in one array operation each step. Letters: B streams, n frames of a call,
T frames at 30 per second, S styles.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.rules import Idle
from deitalk.emotions import LABELS, by_emotion
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.blinks import Blinks
from deitalk.postprocess.life.character import PARTS, Seeds, Traits
from deitalk.postprocess.life.draws import followed
from deitalk.postprocess.life.face import MIRROR, Face
from deitalk.postprocess.life.gaze import Gaze
from deitalk.postprocess.life.head import BREATH, POSTURE_SECONDS, SWALLOWS, Head
from deitalk.postprocess.life.neck import neck_tracks
from deitalk.postprocess.life.voice import PAUSE, Cues, Voice
from deitalk.postprocess.tracks import MotionTracks
from rig.arrays import AnyFloat, Bool, Float32, Float64, Int64
from rig.curves import HEAD

ADDED_CONTROLS = ("_eye_blink.", "_eye.t")
"""Parts of the names of controls that blinks and gaze move, whatever the emotion."""
SPEAKING_LEAD = 10
"""Frames by which speech moves the head before it is there, in a take that is known: those by
which the smoothing is late."""
AGAINST = np.array([1, -1], np.float32)
"""Signs of a turn of the eyes that undoes yaw and pitch of the head."""
STARE = 0.8
"""Share of the aversions that anger takes away at intensity 1: its gaze stays on the listener."""
TURN_FRAMES = 6
"""Frames in which the eyes turn to another place, as long as an emotion takes to change."""
MOST_SHOWN = 1.5
"""Intensity above which accents and posture grow no more."""
MIRRORED = 1 / 3
"""Share of another one's feeling that a listener shows."""
MIRROR_SECONDS = 1.2
"""Time constant with which it comes and goes."""
TALK_SECONDS, BEGIN_SECONDS = 1.5, 0.2
"""Time constants with which a face that talks begins to rest, and one that rests to talk."""
BLOCK_FRAMES = 1024
"""Frames of a take that are moved at once."""
_MIRROR = by_emotion(MIRROR)


class Motion(NamedTuple):
    """Motion of consecutive frames above the mouth."""

    tracks: MotionTracks
    """What `deitalk.postprocess.life.play.Play` plays."""
    head: Float32
    """Track of the head [shape=(..., n, 6)], see `deitalk.postprocess.life.head`."""


def attend(gaze: Float64, held: Float64, mixture: Float32) -> Float64:
    """Gaze of an emotion, degrees: anger stares, sadness alone looks where its head is lowered to.

    Parameters
    ----------
    gaze : array [shape=(..., 2)]
        Fixations and aversions of a neutral face.
    held : array [shape=(..., 2)]
        Turn of the eyes that undoes the posture of the head.
    mixture : array [shape=(..., S)]
        Emotion shown at each frame.
    """
    angry, sad = (mixture[..., [LABELS.index(name)]] for name in ("angry", "sad"))
    shown: Float64 = gaze * np.maximum(1 - STARE * angry, 0) + held * np.maximum(1 - sad, 0)
    return shown


class Character(NamedTuple):
    """Who moves in a stream, and how far."""

    seeds: Seeds
    life: Life = Life()
    traits: Traits | None = None
    """Drawn from the seeds by default."""


class MotionStreams:
    """Eyes, brows, head and neck of takes or of streams, which the cues of voices move.

    Parameters
    ----------
    characters : sequence of Character
        B.
    idle : Idle
        The model's own numbers.
    end : float or array [shape=(B,)]
        Seconds of the last frame, in which no eye is shut; infinite if it is not known.
    """

    def __init__(
        self,
        characters: Sequence[Character],
        idle: Idle = Idle(),
        end: float | Float64 = math.inf,
    ) -> None:
        self.idle, batch = idle, len(characters)
        self.keys = np.zeros((len(PARTS), batch), np.uint64)
        self.side, self.brow_range, self.head_range, self.avoids = np.zeros((4, batch))
        self.amounts = np.zeros((4, batch))
        """Factors on blinks, gaze, brows and head."""
        self.seconds, self.spread = np.zeros((2, batch))
        self.n_frames = np.zeros(batch, np.int64)
        self.places = np.zeros((batch, 2, 3))
        """Where the listener was, and where the eyes turn to: degrees and cm."""
        self.turns = np.zeros(batch, np.int64)
        """Frames from which on they do."""
        self.speaks, self.talks, self.begins = np.zeros((3, batch, 1))
        self.mirrored = np.zeros((batch, 1, len(LABELS)))
        """State of the filters."""
        for k, character in enumerate(characters):
            self._set(k, character)
        _, blinks, gaze, face, head = self.keys
        self.blinks = Blinks(blinks, self.seconds, self.spread, end)
        self.gaze = Gaze(gaze, self.avoids)
        self.face = Face(face, self.side, self.brow_range)
        self.head = Head(head, self.side, self.head_range)

    def _set(self, stream: int, character: Character) -> None:
        seeds, life, traits = character
        traits = traits or Traits.of(seeds.character())
        self.keys[:, stream] = [seeds.key(part) for part in PARTS]
        self.side[stream], self.avoids[stream] = traits.side, traits.avoids
        self.brow_range[stream], self.head_range[stream] = traits.brow_range, traits.head_range
        amounts = life.times(self.idle)
        self.amounts[:, stream] = amounts.blinks, amounts.gaze, amounts.brows, amounts.head
        factor = traits.blink_interval / max(amounts.blinks, 0.05)
        self.seconds[stream] = factor * self.idle.interval_seconds
        self.spread[stream] = self.idle.interval_spread
        self.places[stream] = life.look_at
        self.n_frames[stream] = self.turns[stream] = 0
        self.speaks[stream] = self.talks[stream] = self.begins[stream] = 0
        self.mirrored[stream] = 0

    def reset(self, stream: int, character: Character) -> None:
        """Begin a stream again."""
        self._set(stream, character)
        for part in (self.blinks, self.gaze, self.face, self.head):
            part.reset(stream)

    def cue(self, cues: Cues) -> None:
        """Take what comes next in the voices."""
        if not len(cues.stream):
            return
        self.blinks.cue(cues)
        self.gaze.cue(cues, self.blinks)
        self.face.cue(cues)
        self.head.cue(cues)

    def hear(self, cues: Cues) -> None:
        """Take what comes next in the voices of those whom the streams listen to."""
        self.head.hear(cues)

    def look_at(self, stream: int, place: tuple[float, float, float], frame: int) -> None:
        """Turn to another place of the listener within `TURN_FRAMES` from a frame on."""
        self.places[stream, 0] = self._places(np.array([stream]), np.array([[frame]]))[0, 0]
        self.places[stream, 1], self.turns[stream] = place, frame

    def _places(self, streams: Int64, frames: Int64) -> Float64:
        """Places of the listeners in some frames [shape=(B, n, 3)]."""
        turned = np.clip((frames + 1 - self.turns[streams, None]) / TURN_FRAMES, 0, 1)
        before, after = self.places[streams].swapaxes(0, 1)[:, :, None]
        found: Float64 = before + turned[..., None] * (after - before)
        return found

    def move(
        self,
        speaking: AnyFloat | Bool,
        mixture: Float32,
        streams: Int64 | None = None,
        felt: Float32 | None = None,
    ) -> Motion:
        """Move the next frames of some streams, or of all.

        Parameters
        ----------
        speaking : array [shape=(B, n)]
            1 in speech, else 0.
        mixture : array [shape=(B, n, S)]
            Emotion shown: weights times intensity.
        streams : array of int, optional [shape=(B,)]
            Which; each once.
        felt : array, optional [shape=(B, n, S)]
            Emotion of those whom they listen to.
        """
        streams = np.arange(len(self.n_frames)) if streams is None else streams
        count, mixture = speaking.shape[1], np.minimum(mixture, MOST_SHOWN)
        first = self.n_frames[streams]
        if (begins := streams[first == 0]).size and count:  # as if it had been so before
            self._settle(begins, speaking[first == 0, :1], mixture[first == 0, :1])
        self.n_frames[streams] += count
        blinks, gaze, brows, amount = self.amounts[:, streams, None, None]
        place = self._places(streams, first[:, None] + np.arange(count))
        looks = self.gaze.play(streams, first, count, place[..., 2])
        lids = self.blinks.play(streams, first, count)
        spoken = speaking.astype(np.float64)
        speaks = _followed(spoken, POSTURE_SECONDS, self.speaks, streams)
        talks = np.maximum(
            _followed(spoken, TALK_SECONDS, self.talks, streams),
            _followed(spoken, BEGIN_SECONDS, self.begins, streams),
        )
        face = self.face.play(streams, first, talks)
        gestures = face.gestures + self._mirror(streams, mixture if felt is None else felt, felt)
        moves = amount * self.head.play(streams, first, speaks)
        posture = amount * self.head.postures(streams, mixture)
        turn = moves[..., : len(HEAD)] * self.head.liveliness(streams, mixture)[..., None]
        head = (turn + posture).astype(np.float32)
        turned, held = turn[..., :2] * AGAINST, posture[..., :2] * AGAINST
        neck = neck_tracks(moves[..., BREATH], moves[..., SWALLOWS], head[..., 0])
        still = np.ones((*speaking.shape, 1))
        tracks = MotionTracks(
            lids * (blinks > 0),
            gaze * (attend(looks[..., :2], held, mixture) + turned) + place[..., :2],
            gaze * (looks[..., :2] + turned) + place[..., :2],
            np.minimum(gaze, 1) * looks[..., 2:],
            face.accents,
            gestures,
            face.posture,
            neck * (amount > 0),
            mixture,
            still * self.side[streams, None, None],
            still * brows,
        )
        return Motion(tracks, head)

    def _settle(self, streams: Int64, speaking: AnyFloat | Bool, mixture: Float32) -> None:
        """Begin streams in the state that their first frame holds."""
        for seconds, states in (
            (POSTURE_SECONDS, self.speaks),
            (TALK_SECONDS, self.talks),
            (BEGIN_SECONDS, self.begins),
        ):
            states[streams] = (1 - 1 / (seconds * FRAME_RATE)) * speaking
        self.head.settle(streams, mixture)

    def _mirror(self, streams: Int64, shown: Float32, felt: Float32 | None) -> Float64 | float:
        """Gestures of a listener who feels with another one [shape=(B, n, 2 K)]."""
        if felt is None and not self.mirrored[streams].any():
            return 0.0
        wanted = 0 * shown if felt is None else MIRRORED * np.minimum(felt, 1)
        rows = _followed(wanted, MIRROR_SECONDS, self.mirrored, streams)
        poses = rows @ _MIRROR
        return np.concatenate((poses, poses), axis=-1)


def _followed(values: AnyFloat, seconds: float, states: Float64, streams: Int64) -> Float64:
    """Values (B, n, ...) that a time constant smooths, with the state of streams."""
    share = 1 / (seconds * FRAME_RATE)
    rows, states[streams] = followed(values, share, states[streams])
    return rows


class Moved(NamedTuple):
    """A whole take that moves."""

    voice: Voice
    """Of the recording, T frames."""
    mixture: Float32
    """Weights of the emotions times the applied intensity [shape=(T, S)]."""
    character: Character
    heard: Voice | None = None
    """Of the one whom it listens to, T frames."""
    felt: Float32 | None = None
    """Emotion of that one [shape=(T, S)]."""


def plan_motion(
    voice: Voice,
    mixture: Float32,
    seeds: Seeds,
    idle: Idle = Idle(),
    life: Life = Life(),
    traits: Traits | None = None,
) -> Motion:
    """Motion of one take."""
    return plan_motions([Moved(voice, mixture, Character(seeds, life, traits))], idle)[0]


def plan_motions(takes: Sequence[Moved], idle: Idle = Idle()) -> list[Motion]:
    """Motion of takes side by side; of each as alone."""
    counts = np.array([take.voice.n_frames for take in takes])
    streams = MotionStreams([take.character for take in takes], idle, (counts - 1) / FRAME_RATE)
    for k, take in enumerate(takes):
        cues = take.voice.cues()
        cues = cues._replace(stream=np.full_like(cues.stream, k))
        if take.heard is not None:
            heard = take.heard.cues()
            streams.hear(heard._replace(stream=np.full_like(heard.stream, k)))
            is_heard = take.heard.is_speaking(cues.time + cues.size)
            cues = cues.where((cues.kind != PAUSE) | ~is_heard)
        streams.cue(cues)
    total = max(int(counts.max()), 1)
    spoken = _beside([take.voice.speaking[SPEAKING_LEAD:] for take in takes], total)
    mixture = _beside([take.mixture for take in takes], total)
    none = np.zeros((0, len(LABELS)), np.float32)
    felt = [none if take.felt is None else take.felt for take in takes]
    others = _beside(felt, total) if any(map(len, felt)) else None
    parts: list[list[Motion]] = [[] for _ in takes]
    for start in range(0, total, BLOCK_FRAMES):
        rows, left = slice(start, start + BLOCK_FRAMES), np.flatnonzero(counts > start)
        other = None if others is None else others[left, rows]
        moved = streams.move(spoken[left, rows], mixture[left, rows], left, other)
        for place, k in enumerate(map(int, left)):
            own = slice(0, counts[k] - start)
            tracks = MotionTracks(*(track[place, own] for track in moved.tracks))
            parts[k].append(Motion(tracks, moved.head[place, own]))
    return [_joined(part) for part in parts]


def _beside(rows: Sequence[Float32], total: int) -> Float32:
    """Rows (T, ...) of takes side by side (B, `total`, ...), zeros after their ends."""
    out = np.zeros((len(rows), total, *rows[0].shape[1:]), np.float32)
    for place, each in zip(out, rows, strict=True):
        place[: len(each)] = each
    return out


def _joined(parts: Sequence[Motion]) -> Motion:
    tracks = (np.concatenate(track) for track in zip(*(p.tracks for p in parts), strict=True))
    return Motion(MotionTracks(*tracks), np.concatenate([part.head for part in parts]))
