"""Protocols of live curves, frames to datagrams: Live Link Face, JSON, VMC over OSC."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property
from typing import Protocol

import numpy as np

from rig.arrays import Float32
from rig.controls import default_controls
from rig.controls.control_set import NEWER_ONLY
from rig.conversion.arkit import (
    ARKIT_ID,
    HEAD,
    HEAD_DEGREES,
    head_values,
    udp_order,
)
from rig.conversion.convert import convert, convert_and_note, known_controls, unshown
from rig.curves import RigCurves
from rig.errors import FormatError, quoted
from rig.face.head_pose import quaternions
from rig.formats.livelink_csv import SUBJECT_REST
from rig.livelink.osc import bundles, message
from rig.livelink.packet import MAX_TEXT_BYTES, PORT, Packet, encode

DEVICE = "DEADBEEF-0000-4000-8000-000000000001"
"""Our device id: 36 characters, the length that some receivers assume."""
HEAD_METRES = 0.1
"""Usual height of a head's joint above the neck's: VMC sends a bone's place with its turn."""
MAX_JSON_BYTES = 60_000
MAX_OSC_BYTES = 1_400
"""Below one Ethernet frame, so that nothing is cut into fragments."""


class LiveProtocol(Protocol):
    """Interface of a protocol for `rig.livelink.sender.send`."""

    @property
    def control_set(self) -> str | None:
        """Control set of the values; None: any."""

    def datagrams(self, frame: int, seconds: float, fps: float, values: Float32) -> list[bytes]:
        """Return the datagrams of one frame."""


@dataclass(frozen=True)
class LiveLinkFace:
    """Live Link Face packets, version 6 (Unreal's Apple ARKit face source)."""

    subject: str = "deitalk"
    control_set: str | None = ARKIT_ID

    def datagrams(self, frame: int, seconds: float, fps: float, values: Float32) -> list[bytes]:
        """Return one packet."""
        rate = Fraction(fps).limit_denominator(1001)
        timing = (rate.numerator, rate.denominator)
        frame = frame % 2**31
        return [encode(Packet(DEVICE, self.subject, frame, 0.0, timing, values[udp_order()]))]


@dataclass(frozen=True)
class PropertyJson:
    """Named properties as JSON, for FACEGOOD's FgLiveLinkReceiver and FgControlRig.

    Controls of the board have the names that FgControlRig looks up (its FgControlRigBPLibrary and
    FgControlRigTypes): a float the bare name, a two-dimensional one ``CTRL_C_jaw.translateX`` and
    ``.translateY``, both in the spelling of the boards up to 2023. Controls that those had not,
    switches and multipliers are left out. Curves of `with_head` have HeadYaw, HeadPitch and
    HeadRoll too. The text is ASCII, as the receiver decodes Latin-1. A
    receiver takes names and order from the first datagram, so they never change.
    """

    subject: str = "deitalk"
    names: Sequence[str] = ()
    control_set: str | None = None

    def datagrams(self, frame: int, seconds: float, fps: float, values: Float32) -> list[bytes]:
        """Return one datagram of text, below 60 kB.

        Raises
        ------
        FormatError
            If the names and values need more.
        """
        properties = [
            {"Name": name, "Value": round(float(values[i]), 6)} for i, name in self._properties
        ]
        content = {self.subject: {"FrameId": frame, "Properties": properties}}
        data = json.dumps(content, separators=(",", ":")).encode("ascii")
        if len(data) > MAX_JSON_BYTES:
            raise FormatError(
                f"a frame of {len(properties)} properties needs {len(data)} bytes; a datagram "
                f"holds {MAX_JSON_BYTES}; send fewer curves"
            )
        return [data]

    @cached_property
    def _properties(self) -> list[tuple[int, str]]:
        """Columns that are sent, and their names there."""
        spelt = facegood_names()
        named = [(i, spelt.get(name, name)) for i, name in enumerate(self.names)]
        return [(i, name) for i, name in named if name]


def with_head(curves: RigCurves) -> RigCurves:
    """Curves with their head track as columns HeadYaw, HeadPitch and HeadRoll, in ARKit's values.

    Curves without a track, or with such columns, stay as they are.
    """
    if curves.head is None or HEAD[0] in curves.names:
        return curves
    values = np.concatenate((curves.values, head_values(curves.head)), axis=1)
    return replace(curves, values=values, names=(*curves.names, *HEAD))


def prepared(curves: RigCurves, protocol: LiveProtocol) -> RigCurves:
    """Curves in the control set of a protocol, with their head."""
    if protocol.control_set is None:
        return curves
    return with_head(convert(curves, protocol.control_set))


def lost_by(curves: RigCurves, protocol: LiveProtocol) -> str:
    """Return a line on what a protocol does not show of curves, or none."""
    if protocol.control_set is not None:
        return convert_and_note(curves, protocol.control_set)[1]
    spelt = facegood_names()
    return unshown(curves, (name for name in curves.names if spelt.get(name, name)), "json")


def rest_values(control_set: str, names: Sequence[str]) -> Float32:
    """Values of a face at rest; 0 for names that the control set has not, but for constants."""
    controls = known_controls(control_set)
    values = np.array([name in SUBJECT_REST[-2:] for name in names], np.float32)
    if controls is not None:
        known = [i for i, name in enumerate(names) if name in controls.names]
        values[known] = controls.rest[controls.indices([names[i] for i in known])]
    return values


@cache
def facegood_names() -> dict[str, str]:
    """Return FgControlRig's name of every control of the board; empty for one it has not."""
    names = {}
    for control in default_controls().controls:
        older, _, axis = (control.mh3_name or control.name).partition(".")
        if older == NEWER_ONLY or control.role in ("switch", "multiplier"):
            names[control.name] = ""
        elif control.type == "Vector2D":
            names[control.name] = f"{older}.translate{axis[-1].upper()}"
        else:
            names[control.name] = older
    return names


@dataclass(frozen=True)
class Vmc:
    """VMC protocol over OSC: one value per curve, then Apply, with a time and an OK before.

    In frames whose HeadYaw, HeadPitch or HeadRoll is not 0 the bone Head is sent too, in Unity's
    axes (left-handed, x right, y up, z forward), turned by roll, pitch and yaw. An avatar without
    ARKit's shapes gets its own, of `rig.conversion.avatars`.
    """

    control_set: str | None = ARKIT_ID

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the values; the head's are last where the control set has none."""
        known = known_controls(self.control_set or ARKIT_ID)
        assert known is not None
        return known.names if HEAD[0] in known.names else (*known.names, *HEAD)

    def datagrams(self, frame: int, seconds: float, fps: float, values: Float32) -> list[bytes]:
        """Return bundles that fit an Ethernet frame each."""
        messages = [
            message("/VMC/Ext/OK", 1),
            message("/VMC/Ext/T", float(seconds)),
            *self._head(values),
            *(
                message("/VMC/Ext/Blend/Val", name, float(value))
                for name, value in zip(self.names, values, strict=False)
            ),
            message("/VMC/Ext/Blend/Apply"),
        ]
        return list(bundles(messages, max_bytes=MAX_OSC_BYTES))

    def _head(self, values: Float32) -> list[bytes]:
        """The message of a turned head."""
        found = [self.names.index(name) for name in HEAD]
        if found[-1] >= len(values) or not values[found].any():
            return []
        x, y, z, w = quaternions([values[found] * np.array(HEAD_DEGREES)])[0].tolist()
        return [message("/VMC/Ext/Bone/Pos", "Head", 0.0, HEAD_METRES, 0.0, x, -y, -z, w)]


@dataclass(frozen=True)
class ProtocolInfo:
    """A protocol: its usual port, and its constructor from subject, names and control set."""

    port: int
    description: str
    make: Callable[[str, Sequence[str], str | None], LiveProtocol]


PROTOCOLS: dict[str, ProtocolInfo] = {
    "livelink": ProtocolInfo(
        PORT, "Live Link Face v6, 61 ARKit values", lambda subject, names, _: LiveLinkFace(subject)
    ),
    "json": ProtocolInfo(
        54321,
        "JSON properties (FgLiveLinkReceiver), all curves by name",
        lambda subject, names, _: PropertyJson(subject, names),
    ),
    "vmc": ProtocolInfo(
        39539,
        "VMC over OSC, 61 ARKit values, or an avatar's",
        lambda subject, names, control_set: Vmc(control_set or ARKIT_ID),
    ),
}


def find_protocol(name: str) -> ProtocolInfo:
    """Return the table entry of a protocol.

    Raises
    ------
    FormatError
        If the name is unknown; the known ones are listed.
    """
    if name not in PROTOCOLS:
        raise FormatError(f"unknown protocol {name!r}; known: {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def make_protocol(
    name: str, subject: str, names: Sequence[str], control_set: str | None = None
) -> LiveProtocol:
    """Return a protocol by its name; `control_set` is that of VMC's values, ARKit's by default.

    Raises
    ------
    FormatError
        If the name is unknown (see `find_protocol`), or `subject` is empty, too long, or cannot be
        written as UTF-8.
    """
    try:
        size = len(subject.encode())
    except UnicodeEncodeError:
        raise FormatError(f"subject {quoted(subject)} is no UTF-8; give another name") from None
    if size > MAX_TEXT_BYTES or (name == "livelink" and not size):
        raise FormatError(f"subject has {size} bytes; 1 to {MAX_TEXT_BYTES} are allowed")
    return find_protocol(name).make(subject, names, control_set)
