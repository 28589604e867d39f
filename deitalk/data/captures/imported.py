"""Captured takes to a dataset folder (docs/dataset.md), whole or not at all."""

import csv
import hashlib
import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import soundfile

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import Recording, load_audio
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.config.rig_file import DATASET_RIG, read_controls, rig_text
from deitalk.data.captures.columns import read_mapping
from deitalk.data.captures.import_report import (
    TAKE_HEADER,
    VOICED_FRAMES,
    Imported,
    TakeReport,
    row_of,
    skipped_files,
    warnings_of,
)
from deitalk.data.captures.labels import Labelling, Labels
from deitalk.data.captures.segments import LONGEST_SECONDS, Span, cut_at_silences, within_captured
from deitalk.data.captures.sources import Source, find_sound, find_takes
from deitalk.data.captures.splits import TRAIN, Piece, check_way, divide
from deitalk.data.captures.take import LEAST_SECONDS, CapturedCurves, paired, read_capture
from deitalk.errors import DataError
from rig import ControlSet, write_curves
from rig.errors import UserError, listed
from rig.files import output_folder

HEADER = (
    "clip", "audio", "curves", "emotion", "speaker", "split", "voice", "source", "offset_s",
    "known", "style", "take", "start_s", "stop_s",
)  # fmt: skip
MARGIN_SECONDS = 0.6
"""Curves before and after a clip, where the take has them: a mended offset finds its frames."""
LENGTH_SECONDS = 0.1
"""Difference of curves and sound that is reported."""

Progress = Callable[[float], None]
PathLike = str | Path


def import_captures(
    sources: PathLike | Sequence[PathLike],
    out: PathLike,
    *,
    actor: str | None = None,
    emotion: str | None = None,
    style: str | None = None,
    pattern: str | None = None,
    table: PathLike | None = None,
    mapping: PathLike | None = None,
    rig: str | ControlSet | None = None,
    fps: float | None = None,
    audio: Sequence[PathLike] = (),
    longest: float = LONGEST_SECONDS,
    keep_listening: bool = False,
    split_by: str = "auto",
    force: bool = False,
    progress: Progress = lambda share: None,
) -> Imported:
    """Write a dataset folder of captured takes, as ``deitalk data import``.

    Every take is read, converted to the board, cut in silences into clips, and labelled; `known`
    of a clip lists the channels that its source can know.

    Parameters
    ----------
    sources : path or sequence of paths
        Files of curves with the recordings beside, videos, or folders of them.
    out : path
        Dataset folder.
    actor, emotion, style : str, optional
        Of all takes.
    pattern : str, optional
        Regular expression on a take's path, with groups ``(?P<actor>…)``, ``(?P<emotion>…)`` or
        ``(?P<style>…)``.
    table : path, optional
        CSV with a column ``take``, and any of actor, emotion, style, voice, split.
    mapping : path, optional
        Table of another rig's curves to the board (`deitalk.data.captures.columns`).
    rig : str or ControlSet, optional
        Another rig, by name, file or its controls, whose curves stay as they are; the dataset is
        for models of that rig, and holds its file.
    fps : float, optional
        Frames per second of files that hold no rate.
    audio : sequence of paths
        Folders of recordings that lie elsewhere.
    longest : float
        Most seconds of a clip, 2 to 60.
    keep_listening : bool
        Keep pauses of more than 1.5 s.
    split_by : {"auto", "actor", "time", "none"}
        Clips that are held out, see `deitalk.data.captures.splits.divide`.
    force : bool
        Replace a dataset folder that deitalk wrote.
    progress : callable
        Given the share done, 0 to 1.

    Returns
    -------
    Imported
        Clips, minutes, notes of every take, and warnings.

    Raises
    ------
    DataError, ConfigError
        If there are no takes, or some cannot be read: the first ones are named with the reason,
        and nothing is written.
    rig.errors.TargetError, rig.errors.ExistsError
        If `out` may not be written.
    """
    labels = Labelling(actor, emotion, style, pattern, None if table is None else Path(table))
    given = [Path(p) for p in ([sources] if isinstance(sources, str | Path) else sources)]
    controls = read_controls(rig) if isinstance(rig, str) else rig
    folders = [Path(folder) for folder in audio]
    if not 2.0 <= longest <= 60.0:
        raise DataError(f"`longest={longest:g}` must be from 2 to 60 seconds", parameter="longest")
    check_way(split_by)
    if mapping is not None and rig is not None:
        raise DataError(
            "curves of another rig stay as they are: leave `mapping` out, it converts to the board",
            parameter="mapping",
        )
    columns = None if mapping is None else read_mapping(Path(mapping))
    takes, skipped = find_takes(given, controls if columns is None else columns.sources)
    faults = []
    with output_folder(Path(out), kind="dataset", force=force, inputs=[*given, mapping]) as stage:
        writer = _Writer(stage, longest, keep_listening)
        if controls is not None:
            (stage / DATASET_RIG).write_text(rig_text(controls), encoding="utf-8")
        names = _names(takes)
        for done, (source, name) in enumerate(zip(takes, names, strict=True)):

            def of_take(share: float, done: int = done) -> None:
                progress((done + share) / len(takes))

            try:
                capture = read_capture(
                    source.curves, mapping=columns, rig=controls, fps=fps, progress=of_take
                )
                sound = load_audio(find_sound(source, capture.audio, folders, takes))
                writer.take(source, name, labels.of(source, name), *paired(capture, sound))
            except UserError as error:
                faults.append(error)
            of_take(1.0)
        if faults:
            first = faults[0]
            count = f"{len(faults)} of {len(takes)} takes cannot be read, nothing was written"
            text = f"{count}; the first: {first}" if len(faults) > 1 else str(first)
            raise DataError(text, parameter=first.parameter)
        labels.check_rows(names)
        splits = writer.finish(split_by)
    # A warning about actors of whom a tuned model will have no style; none without any.
    trained = {row["speaker"] for row in writer.rows if row["split"] == TRAIN}
    others = sorted({row["speaker"] for row in writer.rows} - trained)
    text = f"{listed(others)} only validate and test; split by time to train on every actor"
    return Imported(
        len(writer.rows),
        writer.seconds,
        tuple(writer.reports),
        dict(splits),
        writer.left_out,
        (*skipped_files(skipped), *warnings_of(writer.reports), *([text] if others else [])),
    )


def _names(takes: Sequence[Source]) -> list[str]:
    """Names of takes: of their files, numbered where several have one."""
    names: dict[str, str] = {}
    for take in takes:
        plain = "".join(c if c.isalnum() or c in "-_" else "-" for c in take.stem) or "take"
        numbered = (f"{plain}-{count}" if count > 1 else plain for count in itertools.count(1))
        name = next(name for name in numbered if name.lower() not in names)
        names[name.lower()] = name
    return list(names.values())


@dataclass
class _Writer:
    """Writes clips into a stage and keeps their rows."""

    stage: Path
    longest: float
    keep_listening: bool
    rows: list[dict[str, str]] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    reports: list[TakeReport] = field(default_factory=list)
    lists: dict[tuple[str, ...], str] = field(default_factory=dict)
    """Known channels to the file that lists them."""
    left_out: int = 0
    originals: dict[tuple[Labels, bytes], str] = field(default_factory=dict)
    """Labels and content of a take to the first that has them."""

    @property
    def seconds(self) -> float:
        """Length of all clips."""
        return sum(piece.stop - piece.start for piece in self.pieces)

    def take(
        self,
        source: Source,
        name: str,
        labels: Labels,
        capture: CapturedCurves,
        sound: Recording,
    ) -> None:
        """Cut a take and write its clips."""
        curves = capture.curves
        seconds = min(sound.duration, curves.duration)
        if seconds < LEAST_SECONDS:
            raise DataError(
                f"{source.curves}: {curves.duration:.2f} s of curves and {sound.duration:.2f} s of "
                f"sound; both must last {LEAST_SECONDS:g} s"
            )
        speaking = speech_activity(sound.waveform)
        if not speaking.any() and not self.keep_listening:
            raise DataError(
                f"{source.curves}: its recording holds no speech; leave the take out (`deitalk "
                "data voice` takes silent ones), or `keep_listening=True` keeps silence too",
                parameter="keep_listening",
            )
        prosody = measure_prosody(sound.waveform, len(speaking))
        spans = cut_at_silences(
            speaking, prosody.level, seconds, longest=self.longest,
            keep_listening=self.keep_listening,
        )  # fmt: skip
        digest = hashlib.sha256(curves.values.tobytes() + sound.waveform.tobytes()).digest()
        original = self.originals.setdefault((labels, digest), name)
        if original != name:  # it would be in two splits
            spans = []
        if capture.seen is not None:
            spans = within_captured(spans, capture.seen, curves.fps)
        rows = [slice(round(FRAME_RATE * a), round(FRAME_RATE * b)) for a, b in spans]
        reason = "" if spans else "no speech" if original == name else f"a copy of {original}"
        for number, span in enumerate(spans, 1):
            self._clip(name, f"{name}_{number:03d}", span, labels, capture, sound)
        voiced = prosody.pitch[prosody.voiced]
        self.reports.append(
            TakeReport(
                name,
                capture.kind,
                labels.actor,
                labels.emotion,
                curves.fps,
                seconds,
                float(sum(speaking[row].sum() for row in rows)) / FRAME_RATE,
                len(spans),
                float(np.median(voiced)) if len(voiced) >= VOICED_FRAMES else float("nan"),
                (*capture.notes, *_notes(labels, capture, sound, reason)),
            )
        )

    def _clip(
        self,
        take: str,
        name: str,
        span: Span,
        labels: Labels,
        capture: CapturedCurves,
        sound: Recording,
    ) -> None:
        """Write one clip; its sound starts with a frame, its curves `MARGIN_SECONDS` earlier."""
        curves = capture.curves
        first = int(np.floor(span[0] * curves.fps + 1e-6))
        last = min(int(np.ceil(span[1] * curves.fps - 1e-6)), len(curves))
        start, stop = first / curves.fps, last / curves.fps
        samples = sound.waveform[round(start * SAMPLE_RATE) : round(stop * SAMPLE_RATE)]
        audio, target = f"audio/{name}.flac", f"curves/{name}.npz"
        for path in (audio, target):
            (self.stage / path).parent.mkdir(parents=True, exist_ok=True)
        peak = max(float(np.abs(samples).max(initial=0)), 1.0)
        soundfile.write(self.stage / audio, samples / peak, SAMPLE_RATE, subtype="PCM_16")
        margin = round(MARGIN_SECONDS * curves.fps)
        rows = capture.around(first, last, margin)
        begin = rows.start
        write_curves(self.stage / target, curves.slice_frames(rows.start, rows.stop))
        self.pieces.append(Piece(labels.actor, labels.emotion, take, start, stop, labels.split))
        self.rows.append(
            {
                "clip": name,
                "audio": audio,
                "curves": target,
                "emotion": labels.emotion,
                "speaker": labels.actor,
                "voice": labels.voice,
                "source": "recording",
                "offset_s": f"{(begin - first) / curves.fps:.4f}",
                "known": self._known(capture),
                "style": labels.style,
                "take": take,
                "start_s": f"{start:.4f}",
                "stop_s": f"{stop:.4f}",
            }
        )

    def _known(self, capture: CapturedCurves) -> str:
        """Path of the list of known channels; empty where all are."""
        if len(capture.known) == len(capture.curves.names):
            return ""
        if capture.known not in self.lists:
            count = sum(path.startswith(f"known/{capture.kind}") for path in self.lists.values())
            path = f"known/{capture.kind}{f'-{count + 1}' if count else ''}.txt"
            (self.stage / "known").mkdir(exist_ok=True)
            (self.stage / path).write_text("\n".join(capture.known) + "\n", encoding="utf-8")
            self.lists[capture.known] = path
        return self.lists[capture.known]

    def finish(self, split_by: str) -> Counter[str]:
        """Choose the splits, remove clips between them, write the tables."""
        if not self.rows:
            raise DataError(
                "the takes hold no speech; `keep_listening=True` keeps silence too",
                parameter="keep_listening",
            )
        splits = divide(self.pieces, split_by)
        kept = []
        for row, split in zip(self.rows, splits, strict=True):
            if split:
                kept.append(row | {"split": split})
            else:
                (self.stage / row["audio"]).unlink()
                (self.stage / row["curves"]).unlink()
        self.left_out = len(self.rows) - len(kept)
        self.pieces = [p for p, split in zip(self.pieces, splits, strict=True) if split]
        self.rows = kept
        _write_table(self.stage / "clips.csv", HEADER, kept)
        _write_table(self.stage / "takes.csv", TAKE_HEADER, [row_of(r) for r in self.reports])
        return Counter(row["split"] for row in kept)


def _write_table(path: Path, header: Sequence[str], rows: Sequence[dict[str, str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, header, lineterminator="\n", restval="")
        table.writeheader()
        table.writerows(rows)


def _notes(labels: Labels, capture: CapturedCurves, sound: Recording, reason: str) -> list[str]:
    notes = [f"sound: {text}" for text in sound.warnings]
    difference = capture.curves.duration - sound.duration
    if abs(difference) > LENGTH_SECONDS:
        longer, shorter = ("curves", "sound") if difference > 0 else ("sound", "curves")
        notes.append(f"{longer} {abs(difference):.2f} s longer than {shorter}, cut")
    if reason:
        notes.append(f"{reason}, left out")
    if not labels.is_actor_given:
        notes.append("no actor given, taken as one")
    if not labels.is_emotion_given:
        notes.append("no emotion given, taken as neutral")
    if labels.named:
        notes.append(f"its name has {' and '.join(labels.named)}, taken as {labels.emotion}")
    return notes
