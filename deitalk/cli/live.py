"""`deitalk live`: the face of a voice that has not ended, or of a take, over UDP; and back."""

import gc
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from deitalk.cli.acting_options import Given, acting_options
from deitalk.cli.console import console
from deitalk.cli.options import Backend, Force
from deitalk.cli.udp import Link, is_sound, link_of, record_face, send_source, sender_of, transmit
from deitalk.errors import DeitalkError

TAKES, RECORD = "Takes and curves", "Recording a face"
"""Panels of the help."""


@acting_options
def live(
    given: Given,
    source: Annotated[
        Path | None,
        typer.Argument(help="Recording, played at its own pace; or a take or a file of curves."),
    ] = None,
    mic: Annotated[bool, typer.Option("--mic", help="The microphone instead.")] = False,
    source_name: Annotated[
        str | None, typer.Option("--input", help="Name, part of it, or number of another input.")
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            help="live, or the folder of a causal model; of a recording also default or another, "
            "which reads all of it first."
        ),
    ] = "live",
    host: Annotated[
        str, typer.Option(help="Address of the receiver; with --record, the one to listen on.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(help="UDP port; the protocol's own by default.")
    ] = None,
    protocol: Annotated[str, typer.Option(help="livelink, json or vmc.")] = "livelink",
    subject: Annotated[
        str | None,
        typer.Option(
            help="Subject name in Unreal, deitalk by default; with --record, that of the first "
            "packet."
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0, help="Stop after so much sound or recording, seconds.")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(rich_help_panel=TAKES, help="Rate to send, Hz; the source's by default."),
    ] = None,
    loop: Annotated[
        bool,
        typer.Option("--loop", rich_help_panel=TAKES, help="Begin again at the end, until Ctrl-C."),
    ] = False,
    rig: Annotated[
        str,
        typer.Option(
            rich_help_panel=TAKES,
            help="Controls of json: board, raw, arkit; of json and vmc: an avatar (vrm1 …).",
        ),
    ] = "board",
    play: Annotated[
        bool, typer.Option("--play", rich_help_panel=TAKES, help="Play the audio too.")
    ] = False,
    start_signal: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=TAKES,
            help="HOST:PORT for the OSC message /deitalk/start, sent with the first frame.",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=RECORD,
            help="Write the packets of a phone or of `deitalk live` instead of sending: .csv of "
            "Live Link Face, or any format of `convert`.",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0, rich_help_panel=RECORD, help="Stop after this time without a packet, seconds."
        ),
    ] = None,
    backend: Backend = "auto",
    force: Force = False,
) -> None:
    """Animate a voice while it is spoken, 0.2 s behind it, and send the face.

    Or send a take or curves at their own pace, or record a face that is sent: a .csv keeps the
    packets' own times. Ctrl-C ends it: the face rests, received frames are written. A microphone
    needs the extra mic of the package.

    Examples
    --------
    deitalk live --mic --subject anna

    deitalk live speech.wav --emotion happy --host 192.168.0.12

    deitalk live take/ --subject anna --play

    deitalk live --record scene_take_1_anna.csv --host 0.0.0.0
    """
    if (source is not None) + mic + (record is not None) != 1:
        raise DeitalkError("give one of a recording, a take or curves, --mic, and --record")
    of_model = {"model": model != "live", "backend": backend != "auto"}
    if record is not None:
        _refuse(
            "--record", **dict.fromkeys(given.acting.settings | given.choice.settings, True),
            **of_model, input=source_name,
            protocol=protocol != "livelink", fps=fps, loop=loop, rig=rig != "board", play=play,
            start_signal=start_signal,
        )  # fmt: skip
        record_face(
            record, host, port, subject=subject, seconds=seconds, timeout=timeout, force=force
        )
        return
    link = link_of(host, port, protocol, subject or "deitalk", rig, fps)
    _refuse("sending", timeout=timeout is not None, force=force)
    if source is None:
        _refuse("--mic", **given.choice.settings)
    else:
        _refuse(str(source), input=source_name)
        if not is_sound(source):
            _refuse(str(source), **of_model, **given.choice.settings)
    from deitalk.models.folder import is_causal

    if source is not None and not (is_sound(source) and is_causal(model)):
        send_source(
            source, given, (model, backend), link, fps=fps, seconds=seconds, loop=loop,
            play=play, start_signal=start_signal,
        )  # fmt: skip
        return
    if fps is not None or loop or play or start_signal or (rig != "board" and not link.avatar):
        raise DeitalkError(
            "--fps, --loop, --play, --start-signal and --rig, but for an avatar, are for a take or "
            "curves; leave them out"
        )
    _speak(source, source_name, given, model, backend, link, seconds)


def _refuse(kind: str, **options: Any) -> None:
    """Raise for options that are given, neither None nor False, and that a kind does not use."""
    unused = [f"--{name.replace('_', '-')}" for name, value in options.items() if value]
    if unused:
        raise DeitalkError(f"{kind} does not use {', '.join(unused)}; leave it out")


def _speak(
    speech: Path | None,
    source_name: str | None,
    given: Given,
    model: str,
    backend: str,
    link: Link,
    seconds: float | None,
) -> None:
    """Animate a recording or a microphone while it sounds, and send it."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # products of a frame are small: others only spin
    import numpy as np

    from deitalk.live.animator import LiveAnimator
    from deitalk.live.sources import Microphone, PacedSound
    from deitalk.models.load import load_causal

    network = load_causal(model, backend=backend, lasts=True)
    source: Microphone | PacedSound
    if speech is None:
        is_number = source_name is not None and source_name.isdigit()
        source = Microphone(int(source_name or 0) if is_number else source_name)
    else:
        from deitalk.audio.load import load_chosen

        recording = load_chosen(speech, given.choice)
        console().note(*recording.warnings)
        source = PacedSound(recording.waveform)
    rate = source.sample_rate
    animator = LiveAnimator(network, acting=given.acting, sample_rate=rate)
    animator.feed(np.zeros(rate, np.float32))  # the first call takes longer
    animator.reset()
    gc.collect()
    gc.freeze()  # a full collection of what is here now would stop the face for a tenth of a second
    sender = sender_of(animator, link)
    console().print(
        f"sending to {link}, {1000 * animator.lookahead_seconds:.0f} ms and "
        "the computing behind the sound, Ctrl-C stops"
    )
    try:
        transmit(source, animator, sender, seconds)
    except KeyboardInterrupt:
        pass
    finally:
        sender.rest()
        sender.close()
        if isinstance(source, Microphone):
            source.close()
    report = sender.report()
    console().print(
        f"{report.n_sent} frames, {report.n_skipped} skipped, {report.n_failed} not taken by the "
        f"network; sent {1000 * report.waited[0]:.1f} ms after they were known, at most "
        f"{1000 * report.waited[1]:.1f} ms"
    )
