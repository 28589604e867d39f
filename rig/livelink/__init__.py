"""Live curves over UDP: to Unreal's Live Link, JSON receivers and VMC programs, and back."""

from rig.livelink.pace import LiveReport, LiveSender
from rig.livelink.packet import Packet, decode, encode
from rig.livelink.protocols import PROTOCOLS, find_protocol, make_protocol
from rig.livelink.receiver import Receiver, Recording
from rig.livelink.sender import SendReport, check_address, send

__all__ = [
    "PROTOCOLS",
    "LiveReport",
    "LiveSender",
    "Packet",
    "Receiver",
    "Recording",
    "SendReport",
    "check_address",
    "decode",
    "encode",
    "find_protocol",
    "make_protocol",
    "send",
]
