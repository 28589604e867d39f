import json
import re
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk import animate
from deitalk.cli import app
from deitalk.errors import DeitalkError, MissingError
from rig import RigCurves, default_controls, read_curves, write_curves
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.errors import ExistsError, RigError
from rig.formats.livelink_csv import read_take
from rig.livelink import Receiver, make_protocol, send
from rig.livelink.sender import REST_REPEATS
from rig.mesh import fbx

BOARD = default_controls()


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def curves_file(tmp_path):
    values = np.tile(BOARD.rest, (30, 1))
    values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.5 * np.sin(np.linspace(0, np.pi, 30))
    values[:, BOARD.index("CTRL_L_brow_raiseIn.ty")] = 0.25
    path = tmp_path / "curves.json"
    write_curves(path, RigCurves(values, BOARD.names, intensity=np.ones(30)))
    return path


def test_curves_become_a_live_link_take_at_60_fps(curves_file, tmp_path):
    out = tmp_path / "S_1_anna.csv"
    result = run("convert", curves_file, out, "--to", "livelink", "--fps", "60")
    assert result.exit_code == 0, result.output
    assert "lossy preview" in result.stderr and "left out by livelink: intensity" in result.stderr
    assert result.stdout == ""
    assert read_take(out).fps == 60 and len(read_take(out).ticks) == 60


def test_take_folder_is_converted_with_gain_mirror_and_range(curves_file, tmp_path):
    out = tmp_path / "out.npz"
    result = run(
        "convert",
        tmp_path,
        out,
        "--gain",
        "brow=2",
        "--offset",
        "CTRL_C_jaw.ty=0.1",
        "--mirror",
        "--start",
        "0.2",
        "--end",
        "0.7",
        "--json",
    )
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == {
        "out": str(out),
        "format": "npz",
        "frames": 15,
        "fps": 30.0,
        "notes": [],
    }
    curves = read_curves(out)
    assert curves["CTRL_R_brow_raiseIn.ty"] == pytest.approx(0.5)
    source = read_curves(curves_file)["CTRL_C_jaw.ty"][6:21]
    assert curves["CTRL_C_jaw.ty"] == pytest.approx(source + 0.1, abs=1e-6)


def test_live_link_becomes_board_by_default(curves_file, tmp_path):
    live_link = tmp_path / "S_1_a.csv"
    assert run("convert", curves_file, live_link, "--to", "livelink").exit_code == 0
    for rig, control_set in (
        ("board", "metahuman-185@mh4"),
        ("raw", "metahuman-raw-251@mh4"),
        ("arkit", "arkit-61"),
        ("as-is", "arkit-61"),
    ):
        out = tmp_path / f"{rig}.json"
        assert run("convert", live_link, out, "--rig", rig).exit_code == 0
        assert json.loads(out.read_text())["control_set"] == control_set
    result = run("convert", live_link, tmp_path / "x.json", "--rig", "maya")
    assert "use board, raw, arkit, oculus" in str(result.exception)


def test_convert_refuses_to_overwrite_without_force(curves_file, tmp_path):
    (tmp_path / "out.csv").write_text("mine")
    result = run("convert", curves_file, tmp_path / "out.csv")
    assert isinstance(result.exception, ExistsError)
    assert (tmp_path / "out.csv").read_text() == "mine"
    assert run("convert", curves_file, tmp_path / "out.csv", "--force").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.csv", "out.csv"], "does not exist"),
        (["{curves}", "out.abc"], "no format has the suffix"),
        (["{curves}", "out.csv", "--to", "abc"], "unknown format 'abc'"),
        (["{curves}", "out.csv", "--gain", "brow"], "gain 'brow' must be NAME=NUMBER"),
        (["{curves}", "out.csv", "--gain", "nose_=2"], "unknown control 'nose_'"),
        (["{curves}", "out.csv", "--smooth", "-1"], "finite time of 0 or more"),
        (["{curves}", "out.csv", "--fps", "0"], "fps=0 must be from 1 to 300"),
        (["{curves}", "out.csv", "--start", "9"], "no frame lies from 9 s on; the curves last"),
        (["{emoface}", "out.csv"], "source_fps"),
    ],
)
def test_errors_are_one_line(curves_file, tmp_path, arguments, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    emoface = tmp_path / "take.txt"
    emoface.write_text("0\n")
    result = run("convert", *[a.format(curves=curves_file, emoface=emoface) for a in arguments])
    assert isinstance(result.exception, (DeitalkError, RigError))
    assert message in str(result.exception) and "\n" not in str(result.exception)


@pytest.mark.parametrize(
    ("jaw_at_end", "options", "verdict", "code"),
    [
        (0.0, [], "valid, no error or warning", 0),
        (0.9, [], "valid, 1 warning", 0),
        (0.9, ["--strict"], "not valid, 1 warning", 1),
        (None, [], "not valid, 1 error", 1),
    ],
)
def test_validate_ends_with_a_verdict(curves_file, tmp_path, jaw_at_end, options, verdict, code):
    path, curves = tmp_path / "x.csv", read_curves(curves_file)
    values = curves.values.copy()
    values[-3:, BOARD.index("CTRL_C_jaw.ty")] = jaw_at_end or 0
    write_curves(path, RigCurves(values, BOARD.names))
    if jaw_at_end is None:
        path.write_text("frame,time\n0,0\n")
    done = run("validate", path, *options)
    assert (done.exit_code, done.stdout.splitlines()[-1]) == (code, f"{path}: {verdict}")


def skipped(words):
    """Frames that the sender skipped to keep time, from its output."""
    found = re.search(r"(\d+) skipped", words)
    return int(found[1]) if found else 0


def test_sent_frames_are_received(curves_file, tmp_path):
    """`live` to `live --record` over the loopback interface."""
    out = tmp_path / "T_1_anna.csv"
    command = [sys.executable, "-m", "deitalk", "live"]
    options = ["--record", str(out), "--port", "0", "--seconds", "15", "--timeout", "0.5"]
    with subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True) as receiver:
        port = re.search(r"listening on 127.0.0.1:(\d+)", receiver.stderr.readline())[1]
        arguments = ("--port", port, "--subject", "anna", "--fps", 60)
        sender = run("live", curves_file, *arguments)
        words = receiver.stderr.read().replace("\n", " ")
    assert sender.exit_code == 0 and receiver.returncode == 0
    lost = int(re.search(r"frames of 'anna', (\d+) lost", words)[1])
    assert lost <= skipped(sender.stderr)  # a busy machine skips frames; sent frames arrive
    take = read_take(out)
    jaw = take.values[:, take.names.index("JawOpen")]
    assert jaw.max() == pytest.approx(0.5, abs=0.01) and jaw[-1] == 0


def test_a_take_is_sent_for_the_seconds_given_and_as_it_is(curves_file):
    with Receiver(port=0) as probe:
        done = run("live", curves_file, "--port", probe.port, "--seconds", "0.2")
    assert done.exit_code == 0 and "sending 0.2 s" in done.stderr
    refused = run("live", curves_file, "--emotion", "happy", "--gain", "jaw=2")
    assert "emotion, gain would need its recording" in str(refused.exception)


def received_file(out, *options):
    """Run `live --record` into a file while two subjects are sent; return its output."""
    names = arkit_controls().names
    curves = RigCurves([[0.5] * len(names)] * 20, names, 120.0, control_set=ARKIT_ID)
    command = [sys.executable, "-m", "deitalk", "live"]
    options = ["--record", str(out), "--port", "0", "--seconds", "15", "--timeout", "0.5", *options]
    with subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True) as receiver:
        port = int(re.search(r"listening on 127.0.0.1:(\d+)", receiver.stderr.readline())[1])
        for subject in ("anna", "ben"):
            send(curves, make_protocol("livelink", subject, names), ("127.0.0.1", port))
        words = " ".join(receiver.stderr.read().split())
    return receiver.returncode, words


def test_recording_counts_and_names_other_subjects(tmp_path):
    code, words = received_file(tmp_path / "a.json")
    assert code == 0 and "frames of 'anna'" in words
    assert re.search(r"\d+ frames of other subjects left out: 'ben'; --subject", words)
    curves = read_curves(tmp_path / "a.json", control_set=None)  # JSON by its suffix, not a CSV
    assert curves.control_set == ARKIT_ID
    assert curves["JawOpen"][0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("suffix", "subtype"),
    [("wav", "PCM_16"), ("wav", "FLOAT"), ("flac", "PCM_16"), ("ogg", "VORBIS")],
)
def test_duration_of_rhubarb_is_that_of_any_sound(tmp_path, suffix, subtype):
    """1.01 s are 31 frames, of 1.03 s."""
    speech, take = tmp_path / f"a.{suffix}", tmp_path / "take"
    soundfile.write(speech, np.zeros(44_541), 44_100, subtype=subtype)
    performance = animate(speech)
    performance.save(tmp_path / "saved.rhubarb.json")
    performance.save(take)
    assert run("animate", speech, "-o", tmp_path / "animated.rhubarb.json").exit_code == 0
    assert run("convert", take, tmp_path / "converted.rhubarb.json").exit_code == 0
    for name in ("saved", "animated", "converted"):
        text = json.loads((tmp_path / f"{name}.rhubarb.json").read_text())
        assert text["metadata"]["duration"] == text["mouthCues"][-1]["end"] == 1.01, name


def test_sound_of_a_take_lies_beside_its_fbx(curves_file, tmp_path, monkeypatch):
    """Of the same part; a file that is there stays, and so does the take's own."""
    monkeypatch.setenv("BPY_PYTHON", "python")
    monkeypatch.setattr("rig.formats.glb.baked_picture", lambda head: None)
    monkeypatch.setattr(fbx, "run_blender", lambda source, target, *rest: target.write_bytes(b"x"))
    ramp = np.arange(16_000, dtype=np.int16)
    soundfile.write(tmp_path / "audio.wav", ramp, 16_000)
    out = tmp_path / "part.fbx"
    result = run("convert", tmp_path, out, "--start", "0.2", "--end", "0.7")
    assert result.exit_code == 0 and "part.wav: its sound" in result.stderr
    found, rate = soundfile.read(tmp_path / "part.wav", dtype="int16")
    assert rate == 16_000 and found.tolist() == ramp[3200:11200].tolist()
    (tmp_path / "b.wav").write_bytes(b"mine")
    result = run("convert", tmp_path, tmp_path / "b.fbx")
    assert result.exit_code == 1 and "b.wav exists" in str(result.exception)
    assert not (tmp_path / "b.fbx").exists() and (tmp_path / "b.wav").read_bytes() == b"mine"
    assert run("convert", tmp_path, tmp_path / "audio.fbx", "--force").exit_code == 1
    assert soundfile.info(tmp_path / "audio.wav").frames == 16_000


@pytest.mark.parametrize("name", ["a.usda", "a.unreal.json", "a.txt"])
def test_rig_that_a_format_cannot_hold_is_refused(curves_file, tmp_path, name):
    result = run("convert", curves_file, tmp_path / name, "--rig", "arkit")
    assert result.exit_code == 1
    assert re.search("--rig arkit does not apply to .*; leave it out", str(result.exception))
    assert not (tmp_path / name).exists()


def test_recording_is_no_curves_and_animate_is_named(tmp_path):
    (tmp_path / "speech.wav").write_bytes(b"RIFF")
    result = run("convert", tmp_path / "speech.wav", tmp_path / "a.json")
    assert result.exit_code == 1 and "make a take with deitalk animate" in str(result.exception)
    assert not (tmp_path / "a.json").exists()


def test_recording_of_an_absent_subject_names_those_that_came(tmp_path):
    code, words = received_file(tmp_path / "a.csv", "--subject", "eve")
    assert code != 0 and "no packet of 'eve' was received" in words
    assert "'anna', 'ben'; name one of these" in words
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("protocol", ["json", "vmc"])
def test_other_protocols_send_every_frame(curves_file, protocol):
    result = run("live", curves_file, "--protocol", protocol, "--port", 9)
    assert result.exit_code == 0
    sent = int(re.search(r"(\d+) frames in", result.stderr)[1])
    assert 30 <= sent + skipped(result.stderr) <= 31  # the rest frame may be counted


def test_json_sends_the_given_rig(curves_file):
    with Receiver(port=0) as probe:
        for rig, name in (("board", "CTRL_C_jaw.translateY"), ("raw", "CTRL_expressions_jawOpen")):
            arguments = ["--protocol", "json", "--port", probe.port, "--rig", rig, "--fps", 60]
            assert run("live", curves_file, *arguments).exit_code == 0
            properties = json.loads(probe._socket.recv(65535))["deitalk"]["Properties"]
            assert name in {p["Name"] for p in properties}
            probe._socket.setblocking(False)
            try:
                while probe._socket.recv(65535):
                    pass
            except BlockingIOError:
                probe._socket.settimeout(1)


def test_raw_json_of_a_take_is_a_metahuman_subject(tmp_path):
    """A turn to the right is minus roll, in degrees; cm; the last packets are at rest."""
    values = np.tile(BOARD.rest, (2, 1)).astype(np.float32)
    values[:, BOARD.index("CTRL_C_jaw.ty")] = 0.5
    head = np.tile(np.array([25, 0, 0, 1, 2, 3], np.float32), (2, 1))
    write_curves(tmp_path / "curves.json", RigCurves(values, BOARD.names, head=head))
    with Receiver(port=0) as probe:
        arguments = ["--protocol", "json", "--rig", "raw", "--port", probe.port]
        assert run("live", tmp_path, *arguments).exit_code == 0
        packets = [json.loads(probe._socket.recv(65535)) for _ in range(2 + REST_REPEATS)]
    first, rest = (
        {p["Name"]: p["Value"] for p in packet["deitalk"]["Properties"]}
        for packet in (packets[0], packets[-1])
    )
    assert len(first) == len(packets[0]["deitalk"]["Properties"]) == 251 + 9
    assert first["CTRL_expressions_jawOpen"] == 0.5 and rest["CTRL_expressions_jawOpen"] == 0
    turn = [first[f"Head{name}"] for name in ("Yaw", "Pitch", "Roll")]
    shift = [first[f"HeadTranslation{axis}"] for axis in "XYZ"]
    assert turn == [0, 0, -25] and shift == [-3, 1, 2]
    constants = ("MHFDSVersion", "DisableFaceOverride")
    assert [first[name] for name in ("HeadControlSwitch", *constants)] == [1, 1, 1]
    assert [rest[name] for name in ("HeadYaw", *constants)] == [0, 1, 1]


def test_live_errors_are_one_line(curves_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    (tmp_path / "audio.wav").write_bytes(b"")
    cases = [
        ([tmp_path / "absent.wav"], "does not exist"),
        ([curves_file, "--play"], "no audio to play"),
        ([curves_file, "--protocol", "tcp"], "unknown protocol 'tcp'"),
        ([tmp_path / "absent.wav", "--port", "99999"], "port 99999 must be 1 to 65535"),
        ([tmp_path / "absent.csv", "--port", "0"], "port 0 must be 1 to 65535"),
        ([curves_file, "--start-signal", "here"], "must be HOST:PORT"),
        (["--record", curves_file], "exists; name another"),
        (["--record", tmp_path / "x.csv", "--port", 0, "--seconds", 0.1], "no packet"),
    ]
    for arguments, message in cases:
        result = run("live", *arguments)
        assert isinstance(result.exception, (DeitalkError, RigError)), result.output
        assert message in str(result.exception)
    result = run("live", tmp_path, "--play")
    assert isinstance(result.exception, MissingError) and "pip install" in str(result.exception)
