import hashlib
import json
import re
import select
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from rig import RigCurves, default_controls, rest_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID
from rig.errors import FormatError
from rig.formats.livelink_csv import read_take, write_take
from rig.livelink import Packet, Receiver, decode, encode, make_protocol, protocols, send
from rig.livelink.protocols import (
    MAX_JSON_BYTES,
    MAX_OSC_BYTES,
    PropertyJson,
    lost_by,
    prepared,
    with_head,
)
from rig.livelink.sender import REST_REPEATS, Clock
from tests.readers import take

DEVICE = "DEADBEEF-0000-4000-8000-000000000001"
JAW = 17


def packet(frame=900, jaw=0.5, subject="deitalk", rate=(30, 1)):
    values = np.zeros(61, np.float32)
    values[JAW] = jaw
    return Packet(DEVICE, subject, frame, 0.0, rate, values)


def arkit_curves(n_frames, fps=30.0):
    values = np.zeros((n_frames, 61), np.float32)
    values[:, arkit_controls().index("JawOpen")] = np.arange(1, n_frames + 1) / n_frames
    values[:, arkit_controls().index("LeftEyeYaw")] = -0.25
    return RigCurves(values, arkit_controls().names, fps, control_set=ARKIT_ID)


def test_published_test_vector_is_decoded():
    data = encode(packet())
    assert len(data) == 313
    assert data[:5] == bytes.fromhex("0600000024")
    assert data[41:69] == bytes.fromhex(
        "00000007 64656974616c6b 00000384 00000000 0000001e 00000001 3d"
    )
    assert hashlib.sha256(data).hexdigest() == (
        "b2a3027e739232b2b748fa57718feb636e88c53f380cacb301a60343b3fbf12a"
    )


@given(
    st.text(min_size=1, max_size=30),
    st.integers(0, 2**31 - 1),
    arrays(np.float32, 61, elements=st.floats(-4, 4, width=32)),
)
def test_packets_survive_encoding_and_decoding(subject, frame, values):
    sent = Packet(DEVICE, subject, frame, 0.25, (30000, 1001), values)
    got = decode(encode(sent))
    assert (got.device, got.subject, got.frame, got.rate) == (DEVICE, subject, frame, (30000, 1001))
    assert got.values.tolist() == values.tolist() and got.subframe == 0.25


class FakeTime:
    """A clock that moves by its own steps, some of them long."""

    def __init__(self, stall_at=(), stall=0.0):
        self.t, self.n, self.stall_at, self.stall = 100.0, 0, set(stall_at), stall
        self.clock = Clock(lambda: self.t, self.sleep)

    def sleep(self, seconds):
        self.n += 1
        self.t += seconds + 0.0004 + (self.stall if self.n in self.stall_at else 0)


def sent(curves, n_packets=0, *, subject="a", fake=None, **options):
    """Send curves on a clock of steps; the report and the first packets that arrive."""
    with Receiver(port=0) as receiver:
        address = ("127.0.0.1", receiver.port)
        options["clock"] = (fake or FakeTime()).clock
        report = send(curves, make_protocol("livelink", subject, ()), address, **options)
        receiver._socket.settimeout(60)
        return report, [decode(receiver._socket.recv(65535)) for _ in range(n_packets)]


def test_frames_arrive_in_order_and_the_face_ends_at_rest():
    report, packets = sent(arkit_curves(5), 5 + REST_REPEATS, subject="anna", first_frame=1000)
    assert report.n_sent == 5 and report.n_skipped == 0
    assert [p.frame for p in packets] == list(range(1000, 1000 + 5 + REST_REPEATS))
    assert {(p.subject, p.rate) for p in packets} == {("anna", (30, 1))}
    assert [p.values[JAW] for p in packets[:5]] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert packets[0].values[53 + 2] == pytest.approx(-0.25)  # negative rotations survive
    assert all((p.values == 0).all() for p in packets[5:])


def test_delays_do_not_add_up_over_ten_minutes():
    fake = FakeTime(stall_at=range(50, 18000, 50), stall=0.02)
    report, _ = sent(arkit_curves(18_000), fake=fake)
    assert report.seconds == pytest.approx(17_999 / 30, abs=1 / 30)
    assert report.n_skipped == 0 and report.worst_lateness < 1 / 30


def test_last_frame_is_sent_however_late():
    report, packets = sent(arkit_curves(5), 5, fake=FakeTime(stall_at=[4], stall=0.5))
    assert (report.n_sent, report.n_skipped) == (5, 0) and report.worst_lateness > 0.4
    assert packets[-1].values[JAW] == pytest.approx(1.0)


def test_frames_whose_time_has_passed_are_skipped():
    report, _ = sent(arkit_curves(60), fake=FakeTime(stall_at=[3], stall=0.5))
    assert report.n_skipped == 15 and report.n_sent == 45
    assert report.seconds == pytest.approx(59 / 30, abs=1 / 30)


def test_loop_goes_on_with_rising_numbers_until_stopped():
    stop, seen = threading.Event(), []

    def count(index):
        seen.append(index)
        if len(seen) == 7:
            stop.set()

    _, packets = sent(arkit_curves(3), 7 + REST_REPEATS, loop=True, stop=stop, on_frame=count)
    assert seen == [0, 1, 2, 0, 1, 2, 0]
    assert [packet.frame for packet in packets] == list(range(7 + REST_REPEATS))


def test_interrupt_still_sends_the_face_at_rest():
    def interrupt(_index):
        raise KeyboardInterrupt

    _, packets = sent(arkit_curves(9), 1 + REST_REPEATS, on_frame=interrupt)
    assert packets[-1].values.tolist() == [0] * 61


def test_start_is_signalled_before_the_first_frame():
    order = []
    sent(arkit_curves(2), on_start=lambda: order.append("start"), on_frame=order.append)
    assert order == ["start", 0, 1]


def test_real_clock_sends_at_its_rate_and_the_take_is_received(tmp_path):
    """Also on a busy machine, where the sender is late and skips frames."""
    curves = arkit_curves(30, fps=60)
    with Receiver(port=0) as receiver, ThreadPoolExecutor(1) as thread:
        address = ("127.0.0.1", receiver.port)
        sending = thread.submit(send, curves, make_protocol("livelink", "me", ()), address)
        waiting = partial(select.select, [receiver._socket], [], [], 0)
        recording = receiver.record(is_over=lambda: sending.done() and not waiting()[0])
        report = sending.result()
    assert 0.45 < report.seconds < 1 + report.worst_lateness
    assert recording.subject == "me"
    take = recording.to_take()
    write_take(tmp_path / "a_1_me.csv", take)
    back = read_take(tmp_path / "a_1_me.csv")
    frames = back.ticks // 1000
    assert (np.diff(frames) > 0).all() and (back.ticks % 1000 == 0).all()
    sent = frames < 30  # and the face at rest
    assert sent.sum() == report.n_sent == 30 - report.n_skipped
    assert back.values[sent] == pytest.approx(curves.values[frames[sent]], abs=1e-6)


def test_lost_late_invalid_and_foreign_packets_are_counted():
    frames = [5, 6, 9, 8, 8, 11]
    with Receiver(port=0) as receiver, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", receiver.port))
        for frame in frames:
            link.send(encode(packet(frame, jaw=frame / 20)))
            link.send(b"\x06garbage")
        link.send(encode(packet(7, subject="other")))
        recording = receiver.record(seconds=5, idle_seconds=0.3)
    assert [p.frame for p in recording.packets] == [5, 6, 8, 9, 11]
    assert (recording.n_lost, recording.n_garbage, recording.n_other) == (2, 6, 1)
    assert recording.n_late == 2 and recording.others == ("other",)
    take = recording.to_take()
    assert np.diff(take.ticks).tolist() == [2000, 4000, 2000, 4000]
    assert take.values[:, take.names.index("JawOpen")] == pytest.approx(
        np.array([5, 6, 8, 9, 11]) / 20
    )


def test_to_take_rejects_an_empty_recording():
    with Receiver(port=0) as receiver:
        recording = receiver.record(seconds=0.01)
    with pytest.raises(FormatError, match="no packet was received"):
        recording.to_take()


def test_json_properties_of_a_hand_worked_frame():
    protocol = make_protocol("json", "anna", ("CTRL_C_jaw.ty", "b"))
    (data,) = protocol.datagrams(7, 0.0, 30, np.array([0.5, -0.25], np.float32))
    assert json.loads(data) == {
        "anna": {
            "FrameId": 7,
            "Properties": [
                {"Name": "CTRL_C_jaw.translateY", "Value": 0.5},
                {"Name": "b", "Value": -0.25},
            ],
        }
    }


VECTORS = {
    "CTRL_C_mouth", "CTRL_C_jaw", "CTRL_L_eye", "CTRL_R_eye", "CTRL_C_eye", "CTRL_L_nose",
    "CTRL_R_nose", "CTRL_L_mouth_corner", "CTRL_R_mouth_corner", "CTRL_C_teethU", "CTRL_C_teethD",
    "CTRL_C_tongue", "CTRL_C_tongue_tip", "CTRL_C_tongue_roll",
}  # fmt: skip
"""Two-dimensional fields of FgControlRig's structure (FgControlRigTypes.h)."""


def fg_control_rig(data):
    """The values that FgControlRig takes from a datagram, after FgControlRigBPLibrary.cpp.

    A name is split at its first point: behind it must be translateX or translateY; a name without a
    point is a float. A float of the name of a two-dimensional field would damage that field.
    """
    properties = json.loads(data.decode("latin-1"))["anna"]["Properties"]
    vectors, floats = {}, {}
    for place in properties:
        left, _, right = place["Name"].partition(".")
        if not right:
            floats[left] = place["Value"]
        else:
            vectors.setdefault(left, {})[right] = place["Value"]
    assert len(properties) == 2 * len(vectors) + len(floats), "names are read again every frame"
    assert not VECTORS & set(floats)
    return vectors, floats


def test_json_of_the_board_is_what_fg_control_rig_reads():
    board = default_controls()
    values = np.arange(len(board.names), dtype=np.float32) / 256
    protocol = make_protocol("json", "anna", board.names)
    (data,) = protocol.datagrams(1, 0.0, 30, values)
    vectors, floats = fg_control_rig(data)
    assert set(vectors) == VECTORS
    assert all(set(pair) == {"translateX", "translateY"} for pair in vectors.values())

    def sent(name):
        return pytest.approx(values[board.index(name)], abs=1e-6)

    assert vectors["CTRL_C_jaw"]["translateY"] == sent("CTRL_C_jaw.ty")
    assert vectors["CTRL_C_jaw"]["translateX"] == sent("CTRL_C_jaw.tx")
    assert floats["CTRL_L_brow_down"] == sent("CTRL_L_brow_down.ty")
    # its names are those of the boards up to 2023
    assert vectors["CTRL_C_tongue_roll"]["translateX"] == sent("CTRL_C_tongue_bendTwist.tx")
    assert floats["CTRL_C_tongue_narrowWide"] == sent("CTRL_C_tongue_wideNarrow.ty")
    assert "CTRL_C_tongue_thickThin" not in floats
    assert not any(
        c.role in ("switch", "multiplier") and c.ue_control in floats for c in board.controls
    )


def test_head_track_becomes_columns_whatever_the_rig():
    head = np.array([[25.0, 10.0, -5.0, 0, 0, 0]], np.float32)
    curves = RigCurves(np.zeros((1, 1), np.float32), ("a",), control_set="mine", head=head)
    turned = with_head(curves)
    assert turned.names == ("a", "HeadYaw", "HeadPitch", "HeadRoll")
    np.testing.assert_allclose(turned.values, [[0, -0.5, 0.2, -0.1]], rtol=1e-6)
    assert with_head(turned) is turned
    still = RigCurves(np.zeros((1, 1), np.float32), ("a",))
    assert with_head(still) is still


def test_json_of_the_board_fits_a_datagram_and_more_is_rejected():
    curves = rest_curves(1)
    (data,) = PropertyJson("a", curves.names).datagrams(2**31, 0.0, 30, curves.values[0])
    assert len(data) < 10_000
    many = PropertyJson("a", [f"curve_{i:050d}" for i in range(1000)])
    with pytest.raises(FormatError, match=f"holds {MAX_JSON_BYTES}; send fewer"):
        many.datagrams(0, 0.0, 30, np.zeros(1000, np.float32))


def test_vmc_frames_are_read_by_an_independent_library():
    pythonosc = pytest.importorskip("pythonosc.osc_bundle", reason="needs python-osc")
    from pythonosc.osc_packet import OscPacket

    assert pythonosc
    curves = arkit_curves(2)
    datagrams = make_protocol("vmc", "", ()).datagrams(1, 1 / 30, 30, curves.values[1])
    assert len(datagrams) > 1 and max(map(len, datagrams)) <= MAX_OSC_BYTES
    messages = [m.message for data in datagrams for m in OscPacket(data).messages]
    assert [m.address for m in messages[:2]] == ["/VMC/Ext/OK", "/VMC/Ext/T"]
    assert messages[1].params == pytest.approx([1 / 30])
    values = {m.params[0]: m.params[1] for m in messages[2:-1]}
    assert values["JawOpen"] == 1 and values["LeftEyeYaw"] == -0.25 and len(values) == 61
    assert messages[-1].address == "/VMC/Ext/Blend/Apply"


def test_vmc_sends_an_avatars_shapes_and_its_head():
    pytest.importorskip("pythonosc.osc_packet", reason="needs python-osc")
    from pythonosc.osc_packet import OscPacket

    values = np.tile(default_controls().rest, (2, 1))
    values[1, default_controls().indices(["CTRL_L_eye_blink.ty", "CTRL_R_eye_blink.ty"])] = 1
    head = np.array([[0, 0, 0, 0, 0, 0], [90, 0, 0, 0, 0, 0]], np.float32)
    curves = RigCurves(values, default_controls().names, head=head)
    protocol = make_protocol("vmc", "", (), "vrm1")
    ready = prepared(curves, protocol)
    messages = [
        m.message
        for data in protocol.datagrams(1, 1 / 30, 30, ready.values[1])
        for m in OscPacket(data).messages
    ]
    sent = {m.params[0]: m.params[1] for m in messages if m.address == "/VMC/Ext/Blend/Val"}
    blinks = [sent[name] for name in ("blink", "blinkLeft", "blinkRight")]
    assert blinks[0] + min(blinks[1:]) == pytest.approx(1, abs=1e-3)
    assert set(sent) == {*ready.names} and sent["aa"] == 0
    (bone,) = (m.params for m in messages if m.address == "/VMC/Ext/Bone/Pos")
    # 90 degrees to the right, about Unity's y
    assert bone[4:] == pytest.approx([0, 0.5**0.5, 0, 0.5**0.5], abs=1e-6)


@pytest.mark.parametrize(
    ("turn", "axis", "after"),
    [
        ({"HeadYaw": -90 / 50}, [0, 0, 1], [1, 0, 0]),  # to the right, x in Unity
        ({"HeadPitch": 90 / 50}, [0, 0, 1], [0, 1, 0]),  # up
        ({"HeadRoll": 90 / 50}, [0, 1, 0], [1, 0, 0]),  # to the right shoulder
    ],
)
def test_vmc_turns_the_bone_of_the_head_in_unitys_axes(turn, axis, after):
    pytest.importorskip("pythonosc.osc_packet", reason="needs python-osc")
    from pythonosc.osc_packet import OscPacket

    controls = arkit_controls()
    values = np.zeros(len(controls), np.float32)
    for name, value in turn.items():
        values[controls.index(name)] = value
    data = make_protocol("vmc", "", ()).datagrams(0, 0.0, 30, values)
    messages = [m.message for part in data for m in OscPacket(part).messages]
    (bone,) = [m.params for m in messages if m.address == "/VMC/Ext/Bone/Pos"]
    assert bone[0] == "Head"
    np.testing.assert_allclose(Rotation.from_quat(bone[4:]).apply(axis), after, atol=1e-6)


@pytest.mark.parametrize(
    ("address", "arguments", "expected"),
    [
        (
            "/oscillator/4/frequency", (440.0,),
            "2f6f7363 696c6c61 746f722f 342f6672 65717565 6e637900 2c660000 43dc0000",
        ),
        (
            "/foo", (1000, -1, "hello", 1.234, 5.678),
            "2f666f6f 00000000 2c696973 66660000 000003e8 ffffffff 68656c6c 6f000000 "
            "3f9df3b6 40b5b22d",
        ),
    ],
)  # fmt: skip
def test_osc_messages_are_those_of_the_specification(address, arguments, expected):
    """OSC 1.0, section "Examples": message bytes as printed there."""
    assert protocols.message(address, *arguments) == bytes.fromhex(expected)


@pytest.mark.parametrize("arguments", [(), (1 / 30,), ("Jöw", 0.5, 3), ("", "abc", "abcd")])
def test_osc_messages_equal_those_of_python_osc(arguments):
    pytest.importorskip("pythonosc", reason="needs python-osc")
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder("/VMC/Ext/Blend/Val")
    for argument in arguments:
        builder.add_arg(argument)
    assert protocols.message("/VMC/Ext/Blend/Val", *arguments) == builder.build().dgram


def test_osc_bundles_are_read_by_python_osc_in_order():
    pytest.importorskip("pythonosc", reason="needs python-osc")
    from pythonosc.osc_packet import OscPacket

    messages = [protocols.message(f"/{k}", "text", k) for k in range(10)]  # 20 bytes each
    bundles = list(protocols.bundles(messages, max_bytes=16 + 3 * 24))
    assert [len(data) for data in bundles] == [88, 88, 88, 40]
    read = [timed.message for data in bundles for timed in OscPacket(data).messages]
    assert [(m.address, m.params) for m in read] == [(f"/{k}", ["text", k]) for k in range(10)]


@pytest.mark.parametrize("name", ["livelink", "vmc", "json"])
def test_board_curves_are_converted_for_each_protocol(name):
    curves = rest_curves(2)
    report = send(
        curves, make_protocol(name, "a", curves.names), ("127.0.0.1", 9), clock=FakeTime().clock
    )
    assert report.n_sent == 2


def test_send_rejects_impossible_addresses():
    with pytest.raises(FormatError, match="port 70000 must be 1 to 65535"):
        send(arkit_curves(1), make_protocol("livelink", "a", ()), ("127.0.0.1", 70000))
    with pytest.raises(FormatError, match="no frames to send"):
        send(rest_curves(0), make_protocol("livelink", "a", ()), ("127.0.0.1", 9))
    with pytest.raises(FormatError, match="unknown protocol 'tcp'; known: livelink, json, vmc"):
        make_protocol("tcp", "a", ())


def test_decode_rejects_times_beyond_the_limit():
    """Frames at a rate of nearly 0 are centuries away."""
    packet = Packet("phone", "anna", 2**31 - 1, 0.0, (1, 2**31 - 1), np.zeros(61, np.float32))
    with pytest.raises(FormatError, match=r"at most 4\.29"):
        decode(encode(packet))


def test_what_a_protocol_does_not_show_is_counted():
    curves = take()
    assert lost_by(curves, make_protocol("livelink", "a", ())).startswith(
        "ARKit is a lossy preview"
    )
    assert "vrm1: the shapes show" in lost_by(curves, make_protocol("vmc", "", (), "vrm1"))
    protocol = make_protocol("json", "a", curves.names)
    (packet,) = (json.loads(data) for data in protocol.datagrams(0, 0.0, 30, curves.values[0]))
    sent = len(packet["a"]["Properties"])
    told = re.match(r"json does not show (\d+) moving controls", lost_by(curves, protocol))
    assert sent + int(told[1]) == 185
    raw = convert(curves, RAW_ID)
    assert lost_by(raw, make_protocol("json", "a", raw.names)) == ""
