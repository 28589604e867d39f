"""Faces over UDP for `deitalk live`: send a take or curves, record what is sent."""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from deitalk.cli.acting_options import Given
from deitalk.cli.console import console
from deitalk.cli.options import control_set_of
from deitalk.cli.targets import curves_of, note_reading, reserve_file
from deitalk.errors import DeitalkError, MissingError

if TYPE_CHECKING:
    from deitalk.audio.choice import AudioChoice
    from deitalk.live.animator import LiveAnimator
    from deitalk.live.sources import Source
    from rig import RigCurves
    from rig.livelink import LiveSender

PORT = 11111
"""UDP port of Live Link Face."""
POLL_SECONDS = 0.05
"""Longest wait for sound."""


@dataclass(frozen=True)
class Link:
    """Address and protocol to which a face is sent."""

    host: str
    port: int
    protocol: str
    subject: str
    rig: str = "board"

    @property
    def avatar(self) -> str | None:
        """Control set of VMC's values where they are an avatar's."""
        from rig.conversion.avatars import AVATARS

        return self.rig if self.protocol == "vmc" and self.rig in AVATARS else None

    def __str__(self) -> str:
        return f"{self.host}:{self.port} as {self.subject!r}"


def link_of(
    host: str, port: int | None, protocol: str, subject: str, rig: str, fps: float | None
) -> Link:
    """A link with the given port or the protocol's own; raises before anything is animated."""
    from rig.conversion.avatars import AVATARS
    from rig.curves import snap_fps
    from rig.livelink import check_address, find_protocol, make_protocol

    control_set_of(rig)
    if (rig == "raw" and protocol != "json") or (rig in AVATARS and protocol == "livelink"):
        raise DeitalkError(
            f"--rig {rig} does not apply to --protocol {protocol}, which sends ARKit's values; "
            "use --protocol json, or leave it out"
        )
    own = find_protocol(protocol).port
    if port is not None and not 0 < port < 65536:
        raise DeitalkError(f"port {port} must be 1 to 65535; leave it out for {own}")
    make_protocol(protocol, subject, ())
    if fps is not None:
        snap_fps(fps)
    port = own if port is None else port
    check_address((host, port))
    return Link(host, port, protocol, subject, rig)


def frame_of_day(fps: float) -> int:
    """Number of the frame that is now, counted from midnight."""
    now = datetime.now().astimezone()
    midnight = now.replace(hour=0, minute=0, second=0, microsecond=0)
    return int((now - midnight).total_seconds() * fps)


def record_face(
    out: Path,
    host: str,
    port: int | None,
    *,
    subject: str | None,
    seconds: float | None,
    timeout: float | None,
    force: bool,
) -> None:
    """Write Live Link Face packets to a file until Ctrl-C, SIGTERM, SIGHUP or a time.

    Parameters
    ----------
    out : Path
        A .csv keeps the packets' own times; any other format has an even rate.
    host : str
        Address to listen on; 0.0.0.0 is the whole network.
    port : int, optional
        0 takes a free one.
    subject : str, optional
        That of the first packet by default.
    seconds, timeout : float, optional
        Longest recording; longest time without a packet.
    force : bool
        Replace the file.
    """
    from deitalk.signals import held
    from rig import write_curves
    from rig.files import atomic_write
    from rig.formats import find_format
    from rig.formats.livelink_csv import write_take
    from rig.livelink import Receiver

    if port is not None and not 0 <= port < 65536:
        raise DeitalkError(f"port {port} must be 0 to 65535; 0 takes a free one")
    chosen = find_format(out, writable=True)
    reserve_file(out, force=force)
    with Receiver(host, PORT if port is None else port) as receiver, held() as signals:
        console().print(f"listening on {host}:{receiver.port}, Ctrl-C ends the take")
        recording = receiver.record(
            subject=subject, seconds=seconds, idle_seconds=timeout, is_over=lambda: bool(signals)
        )
        take = recording.to_take()
        if chosen.name in ("csv", "livelink"):
            with atomic_write(out) as beside:
                write_take(beside, take)
        else:
            write_curves(out, take.to_curves())
        signals.clear()  # handled: the take has ended
    console().print(
        f"{out}: {len(take.ticks)} frames of {recording.subject!r}, {recording.n_lost} lost, "
        f"{recording.n_late} late, {recording.n_garbage} invalid datagrams"
    )
    if recording.n_other:
        names = ", ".join(map(repr, recording.others))
        console().note(
            f"{recording.n_other} frames of other subjects left out: {names}; "
            "--subject takes one of them"
        )


def is_sound(source: Path) -> bool:
    """Whether a source is a recording, not a take or a file of curves."""
    from rig.errors import FormatError
    from rig.formats.table import find_format

    if not source.exists():
        raise DeitalkError(f"{source} does not exist; give a take, a file of curves or a recording")
    if source.is_dir():
        return False
    if not source.is_file():
        raise DeitalkError(f"{source} is not a regular file; give a take, curves or a recording")
    try:
        find_format(source, readable=True)
    except FormatError:
        return True
    return False


def send_source(
    source: Path,
    given: Given,
    model: tuple[str, str],
    link: Link,
    *,
    fps: float | None,
    seconds: float | None,
    loop: bool,
    play: bool,
    start_signal: str | None,
) -> None:
    """Send a take, a file of curves, or a recording that a model and backend animate first."""
    from rig.conversion.convert import convert
    from rig.formats.livelink_csv import with_subject
    from rig.livelink import make_protocol, send
    from rig.livelink.protocols import lost_by, with_head

    started = [_signal(start_signal)] if start_signal else []
    curves, audio = _curves(source, given, fps, *model)
    if link.protocol == "json":
        # Curves of the rig with their head, as a receiver of that rig takes it.
        curves = convert(curves, control_set_of(link.rig))
        curves = with_subject(curves) if link.rig == "raw" else with_head(curves)
    if play:
        started = [_player(audio, given.choice), *started]
    if seconds is not None:
        curves = curves.slice_seconds(0, seconds)
    chosen = make_protocol(link.protocol, link.subject, curves.names, link.avatar)
    if lost := lost_by(curves, chosen):
        console().note(lost)
    console().print(f"sending {curves.duration:.1f} s to {link}, Ctrl-C stops")

    def start() -> None:
        for action in started:
            action()

    report = send(
        curves,
        chosen,
        (link.host, link.port),
        loop=loop,
        first_frame=frame_of_day(curves.fps),
        on_start=start,
    )
    console().print(
        f"{report.n_sent} frames in {report.seconds:.2f} s, {report.n_skipped} skipped, "
        f"at most {1000 * report.worst_lateness:.1f} ms late"
    )


def _curves(
    source: Path, given: Given, fps: float | None, model: str, backend: str
) -> "tuple[RigCurves, Path | None]":
    """Return curves to send, and the audio that belongs to them."""
    from rig import read_curves

    if is_sound(source):
        from deitalk.pipeline.curves import animate

        console().print(f"animating {source.name}")
        performance = animate(
            source, acting=given.acting, model=model, backend=backend, **given.choice.settings
        )
        console().note(*performance.recording.warnings)
        return performance.at(fps)[0], source
    if given.acting.settings:
        raise DeitalkError(
            f"{source} is sent as it is: {', '.join(given.acting.settings)} would need its "
            "recording; leave the option out"
        )
    curves = read_curves(curves_of(source), control_set=None)
    note_reading(curves)
    audio = source / "audio.wav"
    curves = curves if fps is None else curves.resample(fps)
    return curves, audio if audio.is_file() else None


def _player(audio: Path | None, choice: "AudioChoice") -> Callable[[], None]:
    """Return a function that starts the sound and returns at once."""
    if audio is None:
        raise DeitalkError("there is no audio to play: send a take folder or a recording")
    try:
        import sounddevice  # type: ignore[import-untyped]
    except (ImportError, OSError) as error:
        raise MissingError(
            f"playing audio needs the package sounddevice and PortAudio ({error}); "
            "pip install sounddevice, or leave --play out"
        ) from error
    from deitalk.audio.frames import SAMPLE_RATE
    from deitalk.audio.load import load_chosen

    recording = load_chosen(audio, choice)
    return lambda: sounddevice.play(recording.waveform, SAMPLE_RATE)


def _signal(address: str) -> Callable[[], None]:
    """Return a function that signals the first frame to another program."""
    from rig.livelink import check_address
    from rig.livelink.osc import message

    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isdigit() and 0 < int(port) < 65536):
        raise DeitalkError(f"--start-signal {address!r} must be HOST:PORT, such as 127.0.0.1:8000")
    check_address((host, int(port)))

    def send_start() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.sendto(message("/deitalk/start"), (host, int(port)))

    return send_start


def transmit(
    source: "Source",
    animator: "LiveAnimator",
    sender: "LiveSender",
    seconds: float | None = None,
) -> None:
    """Animate the sound of a source and send the frames, until it or the given time is over."""
    taken, most = 0, None if seconds is None else seconds * source.sample_rate
    while not (source.is_over or (most is not None and taken >= most)):
        wait = sender.wait()
        block = source.read(POLL_SECONDS if wait is None else min(wait, POLL_SECONDS))
        if block is not None:
            taken += len(block)
            frames = animator.feed(block)
            sender.push(frames, animator.head)
        sender.send_due()
    frames = animator.finish()
    sender.push(frames, animator.head, catch_up=False)
    sender.drain()


def sender_of(animator: "LiveAnimator", link: Link) -> "LiveSender":
    """Sender of the frames of an animator, at its pace."""
    from rig.conversion.arkit import HEAD
    from rig.livelink import LiveSender, make_protocol

    is_json = link.protocol == "json"
    names = (*animator.names, *HEAD) if is_json else animator.names
    return LiveSender(
        make_protocol(link.protocol, link.subject, names, link.avatar),
        (link.host, link.port),
        animator.names,
        animator.network.controls.id,
        animator.fps,
        sends_head=is_json,
        first_frame=frame_of_day(animator.fps),
        note=console().note,
    )
