"""`deitalk livelink`: send a face live, receive one, replay a take."""

import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deitalk.cli.acting import Given, acting_options
from deitalk.cli.console import console
from deitalk.cli.options import CheckedCommands, Force, Model, control_set_of
from deitalk.cli.paths import curves_of, reserve_file
from deitalk.errors import DeitalkError, MissingError

if TYPE_CHECKING:
    from deitalk.acting import Acting
    from rig import RigCurves
    from rig.formats.livelink_csv import LiveLinkTake
    from rig.livelink.protocols import LiveProtocol

app = CheckedCommands(help="Send a face live over UDP, receive one, replay a take.")

Host = Annotated[str, typer.Option(help="Address of the receiver.")]
Port = Annotated[int | None, typer.Option(help="UDP port; the protocol's own by default.")]
ProtocolName = Annotated[str, typer.Option(help="livelink, json or vmc.")]
Subject = Annotated[str, typer.Option(help="Subject name in Unreal.")]
SentRig = Annotated[
    str,
    typer.Option(help="Controls of json: board, raw, arkit; of json and vmc: an avatar (vrm1 …)."),
]
Fps = Annotated[float | None, typer.Option(help="Rate to send, Hz; the source's by default.")]
Loop = Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")]
StartSignal = Annotated[
    str | None,
    typer.Option(help="HOST:PORT for the OSC message /deitalk/start, sent with the first frame."),
]


@app.command()
@acting_options
def send(
    source: Annotated[Path, typer.Argument(help="Take folder, file of curves, or a recording.")],
    given: Given,
    model: Model = "default",
    host: Host = "127.0.0.1",
    port: Port = None,
    protocol: ProtocolName = "livelink",
    subject: Subject = "deitalk",
    fps: Fps = None,
    loop: Loop = False,
    rig: SentRig = "board",
    play: Annotated[bool, typer.Option("--play", help="Play the audio too.")] = False,
    start_signal: StartSignal = None,
) -> None:
    """Send a take, a file of curves, or a recording that is animated first.

    Acting and model are for a recording. The face rests at the end and on Ctrl-C.

    Examples
    --------
    deitalk livelink send take/ --subject anna --play

    deitalk livelink send speech.wav --emotion happy --host 192.168.0.12

    deitalk livelink send take/curves.json --protocol json --loop

    deitalk livelink send take/ --protocol vmc --rig vrm1
    """
    from rig.livelink import make_protocol

    _check_rig(rig, protocol)
    signals = [_signal(start_signal)] if start_signal else []
    port = checked_port(host, port, protocol, subject, fps)
    curves, audio = _source(source, given.acting, model)
    if protocol == "json":
        curves = _as_rig(curves, rig)
    started = [_player(audio), *signals] if play else signals
    if (avatar := vmc_set(rig, protocol)) is not None:
        from rig.conversion.convert import convert_and_note

        console().note(convert_and_note(curves, avatar)[1])
    chosen = make_protocol(protocol, subject, curves.names, avatar)
    _send(curves, chosen, (host, port), subject, fps, loop, started)


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="Live Link Face CSV, or any file of curves.")],
    host: Host = "127.0.0.1",
    port: Port = None,
    protocol: ProtocolName = "livelink",
    subject: Subject = "deitalk",
    fps: Fps = None,
    loop: Loop = False,
) -> None:
    """Send a recorded file in the phone's protocol, to test the connection to Unreal.

    Examples
    --------
    deitalk livelink replay MySlate_1_iPhone.csv --loop
    """
    from rig import read_curves
    from rig.livelink import make_protocol

    port = checked_port(host, port, protocol, subject, fps)
    curves = read_curves(curves_of(file), control_set=None)
    chosen = make_protocol(protocol, subject, curves.names)
    _send(curves, chosen, (host, port), subject, fps, loop, [])


@app.command()
def receive(
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write; .csv: Live Link Face.")],
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 is the whole network.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="UDP port; 0 takes a free one.")
    ] = 11111,
    subject: Annotated[
        str | None, typer.Option(help="Subject to record; that of the first packet by default.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0, help="Longest recording, seconds; else until Ctrl-C.")
    ] = None,
    idle: Annotated[
        float | None, typer.Option(min=0, help="Stop after this time without a packet, seconds.")
    ] = None,
    force: Force = False,
) -> None:
    """Record Live Link Face packets, from a phone or from `send`, into a file.

    A .csv keeps the packets' own times; any other format of `convert` has an even rate. Ctrl-C,
    SIGTERM and SIGHUP end the take; received frames are written.

    Examples
    --------
    deitalk livelink receive -o scene_take_1_anna.csv --host 0.0.0.0

    deitalk livelink receive -o anna.json --subject anna
    """
    from deitalk.cli.signals import held
    from rig.formats import find_format
    from rig.livelink import Receiver

    find_format(out, writable=True)
    reserve_file(out, force=force)
    with Receiver(host, port) as receiver, held() as signals:
        console().print(f"listening on {host}:{receiver.port}, Ctrl-C ends the take")
        recording = receiver.record(
            subject=subject, seconds=seconds, idle_seconds=idle, is_over=lambda: bool(signals)
        )
        take = recording.to_take()
        _write_recording(out, take)
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


def _write_recording(out: Path, take: "LiveLinkTake") -> None:
    from rig import write_curves
    from rig.files import atomic_write
    from rig.formats import find_format
    from rig.formats.livelink_csv import write_take

    if find_format(out, writable=True).name in ("csv", "livelink"):
        with atomic_write(out) as beside:
            write_take(beside, take)
    else:
        write_curves(out, take.to_curves())


def _send(
    curves: "RigCurves",
    chosen: "LiveProtocol",
    address: tuple[str, int],
    subject: str,
    fps: float | None,
    loop: bool,
    started: list[Callable[[], None]],
) -> None:
    from datetime import datetime

    from rig.livelink import send as transmit

    if fps is not None:
        curves = curves.resample(fps)
    midnight = datetime.now().astimezone().replace(hour=0, minute=0, second=0, microsecond=0)
    since = (datetime.now().astimezone() - midnight).total_seconds()
    console().print(
        f"sending {curves.duration:.1f} s to {address[0]}:{address[1]} as {subject!r}, Ctrl-C stops"
    )

    def start() -> None:
        for action in started:
            action()

    report = transmit(
        curves,
        chosen,
        address,
        loop=loop,
        first_frame=int(since * curves.fps),
        on_start=start,
    )
    console().print(
        f"{report.n_sent} frames in {report.seconds:.2f} s, {report.n_skipped} skipped, "
        f"at most {1000 * report.worst_lateness:.1f} ms late"
    )


def checked_port(
    host: str, port: int | None, protocol: str, subject: str, fps: float | None
) -> int:
    """The given port or the protocol's own; raises before a recording is animated."""
    from rig.curves import snap_fps
    from rig.livelink import check_address, find_protocol, make_protocol

    own = find_protocol(protocol).port
    if port is not None and not 0 < port < 65536:
        raise DeitalkError(f"port {port} must be 1 to 65535; leave it out for {own}")
    make_protocol(protocol, subject, ())
    if fps is not None:
        snap_fps(fps)
    port = own if port is None else port
    check_address((host, port))
    return port


def _source(source: Path, acting: "Acting", model: str) -> "tuple[RigCurves, Path | None]":
    """Return curves to send, and the audio that belongs to them."""
    from rig import read_curves
    from rig.errors import FormatError
    from rig.formats.table import find_format

    if not source.exists():
        raise DeitalkError(f"{source} does not exist; give a take, a file of curves or a recording")
    if source.is_dir():
        audio = source / "audio.wav"
        path = curves_of(source)
        return read_curves(path, control_set=None), audio if audio.is_file() else None
    if not source.is_file():
        raise DeitalkError(f"{source} is not a regular file; give a take, curves or a recording")
    try:
        find_format(source, readable=True)
    except FormatError:
        from deitalk.pipeline.curves import animate

        console().print(f"animating {source.name}")
        performance = animate(source, acting=acting, model=model)
        return performance.curves, source
    return read_curves(source, control_set=None), None


def _as_rig(curves: "RigCurves", rig: str) -> "RigCurves":
    """Curves of a rig with their head, as a receiver of that rig takes it."""
    from rig.conversion.convert import convert
    from rig.formats.livelink_csv import with_subject
    from rig.livelink.protocols import with_head

    curves = convert(curves, control_set_of(rig))
    return with_subject(curves) if rig == "raw" else with_head(curves)


def _check_rig(rig: str, protocol: str) -> None:
    """Raise for an unknown rig, and for one that the protocol does not send."""
    from rig.conversion.avatars import AVATARS

    control_set_of(rig)
    if (rig == "raw" and protocol != "json") or (rig in AVATARS and protocol == "livelink"):
        raise DeitalkError(
            f"--rig {rig} does not apply to --protocol {protocol}, which sends ARKit's values; "
            "use --protocol json, or leave it out"
        )


def vmc_set(rig: str, protocol: str) -> str | None:
    """Control set of VMC's values where they are an avatar's."""
    from rig.conversion.avatars import AVATARS

    return rig if protocol == "vmc" and rig in AVATARS else None


def _player(audio: Path | None) -> Callable[[], None]:
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
    from deitalk.audio.load import load_audio

    recording = load_audio(audio)
    return lambda: sounddevice.play(recording.waveform, SAMPLE_RATE)


def _signal(address: str) -> Callable[[], None]:
    """Return a function that signals the first frame to another program."""
    from rig.livelink import check_address, osc

    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isdigit() and 0 < int(port) < 65536):
        raise DeitalkError(f"--start-signal {address!r} must be HOST:PORT, such as 127.0.0.1:8000")
    check_address((host, int(port)))

    def send_start() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.sendto(osc.message("/deitalk/start"), (host, int(port)))

    return send_start
