"""`deitalk live`: the face of a voice that has not ended, over UDP."""

import gc
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deitalk.acting import LIVE_FIELDS
from deitalk.cli.acting import Given, acting_options
from deitalk.cli.console import console
from deitalk.cli.livelink import Host, Port, ProtocolName, Subject, checked_port, vmc_set
from deitalk.cli.options import Backend, control_set_of
from deitalk.errors import DeitalkError

if TYPE_CHECKING:
    from deitalk.acting import Acting
    from deitalk.live.animator import LiveAnimator
    from deitalk.live.sources import Source
    from deitalk.models.protocol import CausalNetwork
    from rig.livelink import LiveSender
    from rig.livelink.live import LiveReport

POLL_SECONDS = 0.05
"""Longest wait for sound."""


@partial(acting_options, fields=LIVE_FIELDS)
def live(
    given: Given,
    speech: Annotated[
        Path | None, typer.Argument(help="Recording, played at its own pace.")
    ] = None,
    mic: Annotated[bool, typer.Option("--mic", help="The microphone instead.")] = False,
    source_name: Annotated[
        str | None, typer.Option("--input", help="Name, part of it, or number of another input.")
    ] = None,
    model: Annotated[
        str, typer.Option(help="live, the folder of a causal model, or its .onnx file.")
    ] = "live",
    backend: Backend = "torch",
    host: Host = "127.0.0.1",
    port: Port = None,
    protocol: ProtocolName = "livelink",
    subject: Subject = "deitalk",
    rig: Annotated[str, typer.Option(help="Of vmc: arkit, or an avatar: vrm1, vrchat …")] = "arkit",
    seconds: Annotated[
        float | None, typer.Option(min=0, help="Stop after so much sound, seconds.")
    ] = None,
) -> None:
    """Animate a voice while it is spoken, 0.2 s behind it, and send the face.

    Ctrl-C ends it; the face rests at the end. A microphone needs the extra mic of the package.

    Examples
    --------
    deitalk live --mic --subject anna

    deitalk live speech.wav --emotion happy --host 192.168.0.12

    deitalk live --mic --protocol vmc --emotion angry=0.5
    """
    if mic == (speech is not None):
        raise DeitalkError("give either a recording or --mic")
    port = checked_port(host, port, protocol, subject, None)
    control_set_of(rig)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # products of a frame are small: others only spin
    from deitalk.live.sources import Microphone, PacedSound
    from deitalk.models.load import load_causal

    network = load_causal(model, backend=backend)
    if speech is not None:
        from deitalk.audio.load import load_audio

        waveform = load_audio(speech).waveform
    source = PacedSound(waveform) if speech is not None else Microphone(_number(source_name))
    animator = _warm_animator(network, source.sample_rate, given.acting)
    sender = _sender(animator, protocol, (host, port), subject, rig)
    console().print(
        f"sending to {host}:{port} as {subject!r}, {1000 * animator.lookahead_seconds:.0f} ms and "
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
    _print(sender.report())


def _warm_animator(network: "CausalNetwork", rate: int, acting: "Acting") -> "LiveAnimator":
    """An animator that has read once: the first call takes longer."""
    import numpy as np

    from deitalk.live.animator import LiveAnimator

    animator = LiveAnimator(network, acting=acting, sample_rate=rate)
    animator.feed(np.zeros(rate, np.float32))
    animator.reset()
    gc.collect()
    gc.freeze()  # a full collection of what is here now would stop the face for a tenth of a second
    return animator


def _print(report: "LiveReport") -> None:
    console().print(
        f"{report.n_sent} frames, {report.n_skipped} skipped, {report.n_failed} not taken by the "
        f"network; sent {1000 * report.waited[0]:.1f} ms after they were known, at most "
        f"{1000 * report.waited[1]:.1f} ms"
    )


def transmit(
    source: "Source",
    animator: "LiveAnimator",
    sender: "LiveSender",
    seconds: float | None = None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Animate the sound of a source and send the frames, until it or the given time is over."""
    taken, most = 0, None if seconds is None else seconds * source.sample_rate
    while not (source.is_over or is_over() or (most is not None and taken >= most)):
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


def _sender(
    animator: "LiveAnimator", protocol: str, address: tuple[str, int], subject: str, rig: str
) -> "LiveSender":
    from datetime import datetime

    from rig.conversion.arkit import HEAD
    from rig.livelink import LiveSender, make_protocol

    now = datetime.now().astimezone()
    midnight = now.replace(hour=0, minute=0, second=0, microsecond=0)
    names = (*animator.names, *HEAD) if protocol == "json" else animator.names
    return LiveSender(
        make_protocol(protocol, subject, names, vmc_set(rig, protocol)),
        address,
        animator.names,
        animator.network.controls.id,
        animator.fps,
        sends_head=protocol == "json",
        first_frame=int((now - midnight).total_seconds() * animator.fps),
        note=console().note,
    )


def _number(name: str | None) -> str | int | None:
    """An input by its number, where it is one."""
    return int(name) if name is not None and name.isdigit() else name
