"""`LiveAnimator`: samples in as they come, curves out a fifth of a second later.

Letters: n frames of a call, P spectra a frame, W samples of a spectrum, C controls.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from deitalk.acting import LIVE_FIELDS, Acting, acted_as
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count, samples_within
from deitalk.audio.resampling import RunningResampler
from deitalk.audio.voice_activity import WINDOW
from deitalk.config.rules import Idle, RulesConfig
from deitalk.emotions import LABELS, EmotionTrack
from deitalk.errors import AudioError, ConfigError
from deitalk.live.analysis import FrameMeasures, VoiceAnalysis
from deitalk.live.cues import CueState, RunningCues
from deitalk.models.load import load_causal
from deitalk.models.protocol import (
    CausalNetwork,
    chosen_actor,
    trained_weights,
)
from deitalk.models.streams import put, take
from deitalk.postprocess.factors import expression_scale, held_intensity
from deitalk.postprocess.feeling import felt_intensity
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.character import Seeds
from deitalk.postprocess.life.motion import Character, MotionStreams
from deitalk.postprocess.life.voice import PAUSE, Cues
from deitalk.postprocess.tracks import GATES, VoiceTracks, shown_columns
from deitalk.postprocess.variants import habit_factors, show_habits
from rig.arrays import Bool, Float32, Int64
from rig.curves import HEAD
from rig.limits import SEED

if TYPE_CHECKING:
    from deitalk.models.curve_model import DEITalk

from deitalk.live.stream import Sound, Stream

BLOCK_FRAMES, FEW_FRAMES = 256, 8
"""Most frames of a stream that the network reads at once, and most of any number."""
Arrays = tuple[Any, ...]
"""State of streams: arrays that begin with the stream."""
Samples = npt.ArrayLike | bytes
Emotion = str | Path | Mapping[str, float] | EmotionTrack


class LiveAnimator:
    """Curves of voices that have not ended.

    Whole recordings and any pieces of them give the same frames, to rounding. Frame t is at
    t / 30 s of its stream and is given once `lookahead_seconds` of sound have come after it.

    Parameters
    ----------
    model : str, Path, DEITalk or CausalNetwork
        A model with a causal frontend, such as ``live``.
    backend : str
        As for `deitalk.models.load.load_network`.
    streams : int
        Voices, each with its own sound, emotion and state; read in one call of the network.
    emotion, acting, fields
        As for `deitalk.animate`, of every stream at the start: emotion, intensity, rest, style,
        variant, life, look_at, gain, rules and seed; stream k has ``seed + k``. Other fields
        of an acting need the whole recording.
    sample_rate : int
        Of the samples, Hz; others than 16000 are resampled.

    Raises
    ------
    CheckpointError
        If there is no such model, or it needs the whole clip.
    EmotionError, ConfigError
        If a field is unknown, out of range, or needs the whole recording.
    AudioError
        If the number of streams or the sample rate is out of range.

    Attributes
    ----------
    network : CausalNetwork
    names : tuple of str
        Controls, in the order of the columns.
    fps : float
        30.
    lookahead_seconds : float
        Sound after a frame that it depends on.
    head : array [shape=(n, 6)], or a list of them for several streams
        Track of the head (`rig.curves.HEAD`: degrees and cm) of the frames that were given last;
        at 0 where it is off.
    """

    fps = float(FRAME_RATE)

    def __init__(
        self,
        model: "str | Path | DEITalk | CausalNetwork" = "live",
        emotion: Emotion = "neutral",
        *,
        acting: Acting | None = None,
        streams: int = 1,
        sample_rate: int = SAMPLE_RATE,
        backend: str = "auto",
        **fields: Any,
    ) -> None:
        self.network = load_causal(model, backend=backend)
        if not 1 <= streams <= 1024:
            raise AudioError(f"streams={streams} must be 1 to 1024; make several animators")
        if not 8_000 <= sample_rate <= 192_000:
            raise AudioError(f"sample_rate={sample_rate} must be 8000 to 192000 Hz")
        self.names, self.sample_rate = tuple(self.network.controls.names), sample_rate
        first = acted_as(emotion, acting, fields, LiveAnimator).check_live()
        self.actings = [
            first.model_copy(update={"seed": (first.seed + k) % (SEED + 1)}) for k in range(streams)
        ]
        grid = self.network.grid
        self.lookahead_seconds = grid.lookahead_seconds
        self.rules = self.network.curve_pass(live=True)
        device = self.network.device
        self.analysis = VoiceAnalysis(self.network.rules, grid, device)
        self.cues = RunningCues(grid.rules_ahead)
        self.other_analysis = VoiceAnalysis(RulesConfig.none(), grid, device)
        self.state, self.past, self.due, self.other = self._first(streams)
        self.streams = [self._stream(k) for k in range(streams)]
        self.fed: set[int] = set()
        """Streams that have been given sound since the last `read`."""
        idle = self.network.rules.idle or Idle()
        self.motion = MotionStreams([self._character(k) for k in range(streams)], idle)
        self.resamplers = [[self._resampler(), self._resampler()] for _ in range(streams)]
        self._no_frames = tuple(np.zeros((0, k), np.float32) for k in (len(self.names), len(HEAD)))
        self.heads = [self._no_frames[1]] * streams

    @property
    def head(self) -> Any:
        """Track of the head of the frames that were given last."""
        return self._single(self.heads)

    def feed(
        self,
        samples: Samples | Sequence[Samples],
        other: Samples | Sequence[Samples | None] | None = None,
    ) -> Any:
        """Take the next samples; return the frames that are known now.

        Parameters
        ----------
        samples : array, bytes, or a sequence of them
            Mono: floating point with full scale 1, 16-bit integers, or bytes of these
            (little-endian), of which an odd one is kept for the next call. Of several streams a
            sequence of one entry each, of any lengths.
        other : array, bytes, or a sequence of them, optional
            Samples of another speaker, from the same time on: the face nods at the ends
            of that one's phrases and keeps its eyes there. Of several streams None for those that
            listen to nobody.

        Returns
        -------
        array [shape=(n, C)], or a list of them for several streams

        Raises
        ------
        AudioError
            If samples are not mono or not finite, or their number is not that of the streams.
        """
        rows: list[Any] = [samples] if len(self.streams) == 1 else list(samples)  # type: ignore[arg-type]
        if len(rows) != len(self.streams):
            raise AudioError(f"samples of {len(rows)} streams; there are {len(self.streams)}")
        others: list[Any] = [other] if len(rows) == 1 or other is None else list(other)  # type: ignore[arg-type]
        if len(others) != len(rows) and other is not None:
            raise AudioError(f"other samples of {len(others)} streams; there are {len(rows)}")
        if are_plain(rows):
            pieces = [(row, self.streams[k].rest) for k, row in enumerate(rows)]
            checked = rows
        else:
            pieces = [self._whole(row, k) for k, row in enumerate(rows)]
            checked = [checked_samples(samples) for samples, _ in pieces]  # before any is taken
        for k, one in enumerate(others):
            if one is not None:
                self.take_other(one, stream=k)
        for k, (row, (_, rest)) in enumerate(zip(checked, pieces, strict=True)):
            self._take(row, rest, k)
        return self._single(self.read())

    def finish(self) -> Any:
        """Take the end of all streams; return their last frames, as `feed`.

        A stream of S seconds then has given ceil(30 S) frames. `reset` begins again.
        """
        for k in range(len(self.streams)):
            self.end(k)
        return self._single(self.read())

    def take(self, samples: Samples, *, stream: int = 0) -> None:
        """Take the next samples of one stream, for the next `read`; errors as `feed`."""
        samples, rest = self._whole(samples, stream)
        self._take(checked_samples(samples), rest, stream)

    def _take(self, samples: Float32, rest: bytes, stream: int) -> None:
        """Take checked samples, and the byte of the next one that came already."""
        if self.streams[stream].n_total is not None and samples.size:
            raise AudioError("the stream has ended; reset it to begin again")
        self._append(stream, samples, last=False)
        self.streams[stream].rest = rest

    def take_other(self, samples: Samples, *, stream: int = 0) -> None:
        """Take samples of the other speaker of a stream, from the time of its own next ones on.

        Raises
        ------
        AudioError
            As `feed`; bytes must be whole samples.
        """
        if isinstance(samples, bytes | bytearray | memoryview) and len(samples) % 2:
            raise AudioError(f"other samples have {len(samples)} bytes; give two for each")
        checked, one = checked_samples(samples), self.streams[stream]
        if (resampler := self.resamplers[stream][1]) is not None:
            checked = resampler.feed(checked, last=False)
        one.append_other(checked, one.sound.end)

    def _whole(self, samples: Samples, stream: int) -> tuple[Samples, bytes]:
        """Whole samples, and the byte of the next one that came already."""
        rest = self.streams[stream].rest
        if not isinstance(samples, bytes | bytearray | memoryview):
            return samples, rest
        data = rest + bytes(samples)
        whole = len(data) - len(data) % 2
        return data[:whole], data[whole:]

    def end(self, stream: int = 0) -> None:
        """Take the end of one stream, for the next `read`."""
        if self.streams[stream].n_total is None:
            self._append(stream, np.zeros(0, np.float32), last=True)
            self.streams[stream].finish()

    def read(self) -> list[Float32]:
        """Frames of every stream that are known now [shape=(n, C)], in one call of the network."""
        self._advance(sorted(self.fed))
        none = self._no_frames
        given = [one.collect() if k in self.fed else none for k, one in enumerate(self.streams)]
        self.fed.clear()
        self.heads = [head for _, head in given]
        return [frames for frames, _ in given]

    def interrupt(
        self,
        stream: int = 0,
        *,
        shown: Float32 | None = None,
        head: Float32 | None = None,
    ) -> int:
        """Stop a voice: its mouth shuts within 0.1 s, the rest of the expression stays.

        Sound that has come and was not given yet is dropped, and silence of `lookahead_seconds`
        follows, so that `read` gives the frames of the shut mouth at once.

        Parameters
        ----------
        stream : int
            Which stream.
        shown : array [shape=(C,)], optional
            Frame that is on the screen, from which the next ones go on; by default the one that
            was given last.
        head : array [shape=(6,)], optional
            Its track of the head.

        Returns
        -------
        int
            Number of the frame at which the sound begins that comes next.

        Raises
        ------
        AudioError
            If the stream has ended.
        ConfigError
            If `shown` is not one frame of finite curves.
        """
        one = self.streams[stream]
        if one.n_total is not None:
            raise AudioError("the stream has ended; reset it to begin again")
        frame = None if shown is None else self._frame(shown, head, one.last[1])
        if not one.sound.end:
            return 0
        one.interrupt(samples_within(self.lookahead_seconds), frame)
        self.fed.add(stream)
        self.resamplers[stream][0] = self._resampler()
        return frame_count(one.sound.end)

    def _frame(
        self, shown: Float32, head: Float32 | None, last: Float32
    ) -> tuple[Float32, Float32]:
        """A frame and its head, checked; without a head the last one."""
        rows = np.asarray(shown, np.float32), np.asarray(last if head is None else head, np.float32)
        if (rows[0].shape, rows[1].shape) != ((len(self.names),), (len(HEAD),)):
            raise ConfigError(
                f"shown of shape {rows[0].shape} must be one frame of {len(self.names)} curves, "
                f"and head {len(HEAD)} numbers"
            )
        if not all(np.isfinite(row).all() for row in rows):
            raise ConfigError("the frame that is shown must be finite; some of it is not")
        return rows

    def set(self, *, stream: int | None = None, **fields: Any) -> None:
        """Change the acting of the sound that comes next: gain and rules at once, others in 0.2 s.

        Parameters
        ----------
        stream : int, optional
            Which stream; all by default.
        **fields
            emotion, intensity, rest, look_at, gain and rules; those that are not given stay as they
            are.

        Raises
        ------
        ConfigError, EmotionError
            If a field is another one, or out of range.
        """
        if fixed := [name for name in fields if LIVE_FIELDS.get(name) != "change"]:
            raise ConfigError(f"{', '.join(fixed)} cannot change while somebody speaks")
        for k in range(len(self.streams)) if stream is None else [stream]:
            one = self.streams[k]
            acting, before = Acting.of(one.acting, **fields).check_live(), one.acting
            one.change(acting)
            if one.moves and acting.look_at != before.look_at:
                self.motion.look_at(k, acting.look_at, frame_count(one.sound.end))

    def reset(self, stream: int | None = None) -> None:
        """Begin a stream again, or all: no sound, first emotion and intensity, first blinks."""
        for k in range(len(self.streams)) if stream is None else [stream]:
            states = self.state, self.past, self.due, self.other
            for state, first in zip(states, self._first(1), strict=True):
                put(state, [k], first)
            self.streams[k] = self._stream(k)
            self.motion.reset(k, self._character(k))
            self.resamplers[k] = [self._resampler(), self._resampler()]

    def open(self, stream: int, acting: Acting) -> None:
        """Begin a stream again with another acting."""
        self.actings[stream] = acting.check_live()
        self.reset(stream)

    def _first(self, batch: int) -> tuple[Arrays, Arrays, Arrays, Arrays]:
        """State before the first sound: of the network, its own voice, the rules, the other one."""
        network = self.network.first_state(batch)
        ahead = self.network.grid.rules_ahead
        mixture = np.zeros((batch, ahead, len(LABELS)), np.float32)
        speaking = np.zeros((batch, ahead), bool)
        due = self.rules.first(batch), mixture, speaking, *self.cues.first(batch)
        other = *self.other_analysis.first(batch), *self.cues.first(batch)
        return network, self.analysis.first(batch), due, other

    def _character(self, number: int) -> Character:
        acting = self.actings[number]
        return Character(Seeds((0, 0, acting.seed)), acting.motion or Life())

    def _stream(self, number: int) -> Stream:
        controls, acting = self.network.controls, self.actings[number]
        moves = acting.motion is not None and self.network.rules.idle is not None and acting.rules
        style = chosen_actor(self.network.actors, acting.style)
        actor = np.array([name == style for name in self.network.actors], np.float32)
        return Stream(self.network.grid, controls, acting, moves, actor)

    def _resampler(self) -> RunningResampler | None:
        return None if self.sample_rate == SAMPLE_RATE else RunningResampler(self.sample_rate)

    def _append(self, number: int, samples: Float32, *, last: bool) -> None:
        resampler = self.resamplers[number][0]
        if resampler is not None:
            samples = resampler.feed(samples, last=last)
        self.streams[number].sound.append(samples)
        self.fed.add(number)

    def _single(self, frames: list[Float32]) -> Any:
        return frames[0] if len(frames) == 1 else frames

    def _advance(self, fed: list[int]) -> None:
        """Finish the frames whose sound has come, of as many of the streams `fed` as have any."""
        self._begin(fed)
        known: dict[tuple[int, int, int | None], int] = {}  # equal streams have equal counts
        waiting = {}
        for k in fed:
            one = self.streams[k]
            if one.groups > 0:
                key = one.sound.end, one.groups, one.n_total
                if key not in known:
                    known[key] = one.n_ready()
                waiting[k] = known[key]
        while ready := [k for k, count in waiting.items() if count > 0]:
            most = min(BLOCK_FRAMES, *[waiting[k] for k in ready])
            # Few sizes, for each of which torch keeps memory: 1 to 8, 16, 32 …
            count = most if most <= FEW_FRAMES else 1 << (most.bit_length() - 1)
            self._read(ready, count)
            for k in ready:
                waiting[k] -= count

    def _begin(self, fed: list[int]) -> None:
        """Read the first groups of streams whose first frame is known now."""
        delay = self.network.grid.delay
        streams = self.streams
        new = [k for k in fed if not streams[k].groups and streams[k].n_ready() >= delay]
        if new:
            windows, _, _ = self._windows([self.streams[k] for k in new], delay)
            self.network.begin(windows, self.state, new)
            starts = np.arange(delay) * SAMPLE_RATE // FRAME_RATE - WINDOW // 2
            sound = np.array([self.streams[k].sound.windows(starts, WINDOW) for k in new])
            put(self.past, new, self.analysis.begin(sound, take(self.past, new)))

    def _directed(self, streams: Sequence[Stream], count: int) -> tuple[Float32, Float32]:
        """Emotion (B, count, 9) and intensity (B, count) that are wanted in the next groups."""
        fixed = [one.wanted for one in streams if one.wanted and not one.changes[1:]]
        if len(fixed) < len(streams):
            parts = zip(*[one.directed(count) for one in streams], strict=True)
            emotion, wanted = (np.stack(part) for part in parts)
            return emotion, wanted
        emotion = np.array([weights for weights, _ in fixed]).astype(np.float32)
        wanted = np.array([intensity for _, intensity in fixed], np.float32)
        return np.repeat(emotion[:, None], count, axis=1), np.repeat(wanted[:, None], count, axis=1)

    def _windows(
        self, streams: Sequence[Stream], count: int
    ) -> tuple[Float32, Float32, list[Float32 | None]]:
        """Sound of the next `count` groups of streams, which are taken then.

        Returns
        -------
        windows : array [shape=(B, count P, W)]
            Of the spectra.
        sound : array [shape=(B, count, `WINDOW`)]
            Of the frames of the groups.
        others : list
            Of the same frames of the other speakers [shape=(count, `WINDOW`)], or None.
        """
        length = self.network.grid.length
        places = [(one.groups, one.sound.begin, one.sound.end) for one in streams]
        if places.count(places[0]) == len(places):  # read at once
            whole, first = Sound.together([one.sound for one in streams]), streams[0]
            windows = whole.windows(first.spectrum_starts(count), length)
            starts = [first.measured_starts(count)] * len(streams)
            sound = whole.windows(starts[0], WINDOW)
        else:
            rows = [one.sound.windows(one.spectrum_starts(count), length) for one in streams]
            starts = [one.measured_starts(count) for one in streams]
            pairs = zip(streams, starts, strict=True)
            sound = np.array([one.sound.windows(at, WINDOW) for one, at in pairs])
            windows = np.array(rows)
        others: list[Float32 | None] = [None] * len(streams)
        for k, one in enumerate(streams):
            one.groups += count
            if one.other is not None:
                others[k] = one.other_windows(starts[k])
            if one.groups % FRAME_RATE < count:
                one.forget()
        return windows, sound, others

    def _read(self, ready: list[int], count: int) -> None:
        """Finish `count` frames of some streams."""
        streams = [self.streams[k] for k in ready]
        # Sound and acting of the frames.
        emotion, wanted = self._directed(streams, count)
        windows, sound, others = self._windows(streams, count)
        ruled = np.array([stream.acting.rules for stream in streams], np.float32)
        # The network: two readings.
        actors = np.array([stream.actor for stream in streams])[:, None]
        actors = np.broadcast_to(actors, (*wanted.shape, actors.shape[-1]))
        styles = np.concatenate((trained_weights(emotion), actors), axis=-1)
        rows = self.network.advance(windows, styles, self.state, ready)
        # Intensity, opening and gates of the voices.
        past = take(self.past, ready)
        stays = np.array([stream.acting.rest for stream in streams], np.float32)
        measured = FrameMeasures.of_windows(sound, self.network.device)
        found, past = self.analysis(measured, rows.strength, rows.effort, stays, past)
        put(self.past, ready, past)
        # Factors.
        rules = self.network.rules
        with_rules = ruled[:, None] > 0
        felt, holds, scale = found.intensity, rows.strength, wanted
        if rules.voice_intensity is not None:
            felt = felt_intensity(felt, emotion, rules.voice_intensity)
            holds = held_intensity(
                rules.expressions,
                self.network.controls,
                rows.neutral,
                rows.emotional,
                emotion,
                rows.strength,
            )
            scale = np.where(with_rules, expression_scale(felt * wanted, holds), wanted)
        applied = np.where(with_rules, felt, rows.strength) * wanted
        opening = np.where(with_rules, found.opening, 1)
        phones = np.zeros((*scale.shape, 4), np.float32)
        back, kept, _ = found.held
        ways = [stream.ways for stream in streams]
        variants = np.stack([way.of(rows) for way, rows in zip(ways, emotion, strict=True)])
        side = np.repeat([[way.side] for way in ways], count, axis=1)
        voice = VoiceTracks(
            scale, opening, holds, phones, emotion, back, kept, variants, side, felt
        ).columns()
        # Gates and motion of the frames that come out.
        before, mixture, speaking, *cues = take(self.due, ready)
        begin = cues[CueState._fields.index("frame")]
        new_cues, known = self.cues(found.measures, found.speaking, CueState(*cues))
        listens = self._listen(ready, others, begin, count)
        self._cue(ready, new_cues, begin, listens)
        mixture = np.concatenate((mixture, emotion * applied[..., None]), axis=1)
        speaking = np.concatenate((speaking, found.speaking), axis=1)
        keyed = np.array([stream.wanted is None for stream in streams])[:, None]
        mouth = np.where(with_rules, found.mouth, 1)
        expression = np.where(with_rules & ~keyed, found.expression, 1)
        if any([stream.shut for stream in streams]):
            mouth = mouth * np.array([stream.mouth_share(count) for stream in streams])
        numbers = [stream.n_given for stream in streams]
        given = [stream.given(count) for stream in streams]
        shown = shown_columns(mouth, expression, None)
        acted = mixture[:, :count] * expression[..., None]
        heads = self._move(ready, given, speaking[:, :count], acted, shown)
        # The rules, in their order: `deitalk.postprocess.curve_pass`.
        gain = np.array([stream.gain for stream in streams])
        curves, plain, _, after = self.rules(
            rows.neutral, rows.emotional, voice, shown, gain, ruled, before
        )
        own = np.array([stream.ways.habits for stream in streams])
        habits = habit_factors(self.network.controls, rules.expressions, own)[:, None]
        habits = np.where(with_rules[..., None], habits, np.float32(1))
        curves = show_habits(curves, plain, self.network.controls, habits)
        due = after, mixture[:, count:], speaking[:, count:], *known
        put(self.due, ready, due)
        finished = zip(streams, curves, heads, given, numbers, strict=True)
        for stream, frames, head, which, first in finished:
            stream.give(frames[which], head[which], first + which.start)

    def _listen(
        self, ready: list[int], others: Sequence[Float32 | None], begin: Int64, count: int
    ) -> Bool:
        """Return the frames in which each stream's other speaker speaks [shape=(B, count)]."""
        speaking = np.zeros((len(ready), count), bool)
        given = [(k, other) for k, other in enumerate(others) if other is not None]
        if not given:
            return speaking
        places = [k for k, _ in given]
        who = [ready[k] for k in places]
        kept: Arrays = take(self.other, who)
        size = len(CueState._fields)
        sound, none = (
            np.stack([other for _, other in given]),
            np.zeros((len(who), count), np.float32),
        )
        measured = FrameMeasures.of_windows(sound, self.network.device)
        analysed, past = self.other_analysis(measured, none, none, none[:, 0], kept[:-size])
        before = CueState(*kept[-size:])._replace(frame=begin[places])
        found, after = self.cues(analysed.measures, analysed.speaking, before)
        now: Arrays = *past, *after
        put(self.other, who, now)
        moving = np.array([self.streams[k].moves for k in who])[found.stream]
        self.motion.hear(found._replace(stream=np.array(who)[found.stream]).where(moving))
        speaking[places] = analysed.speaking
        return speaking

    def _cue(self, ready: list[int], cues: Cues, begin: Int64, listens: Bool) -> None:
        """Move faces by the cues of their voices; while the other speaks, pauses are no cues."""
        row = np.round(cues.known * FRAME_RATE).astype(int) + self.cues.ahead - begin[cues.stream]
        busy = (cues.kind == PAUSE) & listens[cues.stream, np.clip(row, 0, listens.shape[1] - 1)]
        moving = np.array([self.streams[k].moves for k in ready])[cues.stream]
        chosen = cues._replace(stream=np.array(ready)[cues.stream]).where(moving & ~busy)
        self.motion.cue(chosen)

    def _move(
        self,
        ready: list[int],
        given: Sequence[slice],
        speaking: Bool,
        acted: Float32,
        shown: Float32,
    ) -> Float32:
        """Write the motion of the next frames of streams into their columns.

        Parameters
        ----------
        ready : list of int
            The streams; those without life do not move.
        given : sequence of slice
            Which of the n frames each stream gives.
        speaking : array of bool [shape=(B, n)]
            Frames of speech.
        acted : array [shape=(B, n, 9)]
            Emotion shown.
        shown : array [shape=(B, n, 45)]
            Gates and motion; the latter is written.

        Returns
        -------
        array [shape=(B, n, 6)]
            Track of the head.
        """
        heads = np.zeros((*speaking.shape, len(HEAD)), np.float32)
        alike: dict[tuple[int, int], list[int]] = {}  # one, but for first and last frames
        for k, which in enumerate(given):
            if self.streams[ready[k]].moves and which.start < which.stop:
                alike.setdefault((which.start, which.stop), []).append(k)
        for (start, stop), places in alike.items():
            who = np.array(ready)[places]
            frames = places, slice(start, stop)
            motion = self.motion.move(speaking[frames], acted[frames], who)
            shown[places, start:stop, GATES:] = np.concatenate(motion.tracks, axis=-1)
            heads[frames] = motion.head
        return heads


def are_plain(rows: Sequence[Any]) -> bool:
    """Whether all samples are finite float32 of one length, which need no check of their own."""
    shapes = [row.shape for row in rows if type(row) is np.ndarray and row.dtype == np.float32]
    if shapes.count(shapes[0]) < len(rows) if shapes else True:
        return False
    return len(shapes[0]) == 1 and bool(np.isfinite(np.array(rows)).all())


def checked_samples(samples: Samples) -> Float32:
    """Mono samples as floating point with full scale 1.

    Raises
    ------
    AudioError
        If they are not one row of finite samples.
    """
    if isinstance(samples, bytes | bytearray | memoryview):
        samples = np.frombuffer(samples, "<i2")
    array = np.asarray(samples)
    if array.dtype == np.int16:
        array = array.astype(np.float32) / np.float32(32768)
    if array.ndim != 1 or array.dtype.kind != "f":
        raise AudioError(
            f"samples have the shape {array.shape} and the type {array.dtype}; give one row of "
            "floating point, full scale 1, or of 16-bit integers"
        )
    if not np.isfinite(array).all():
        raise AudioError("samples must be finite; some are NaN or infinite")
    return array.astype(np.float32)
