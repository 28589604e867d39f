"""SIGTERM and SIGHUP: files are cleaned up, one line is printed, a live recording is written."""

import pickle
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deitalk.cli import main
from deitalk.errors import DeitalkError
from deitalk.signals import Terminated, catch_signals, held
from deitalk.workers import FORK_SERVER, NEW_PROCESSES, Worker
from rig import RigCurves
from rig.conversion.arkit import ARKIT_ID, arkit_controls
from rig.formats.livelink_csv import read_take
from rig.livelink import make_protocol, send

BOTH = [pytest.param(signal.SIGTERM, id="SIGTERM")]
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
    BOTH.append(pytest.param(signal.SIGHUP, id="SIGHUP"))
WRITES_FOR_EVER = """
import sys, time
from pathlib import Path
from deitalk.cli import app, main
from rig.files import atomic_write

@app.command()
def write(path: Path):
    with atomic_write(path) as beside:
        beside.write_text("half")
        print("writing", flush=True)
        for _ in range(600):  # Python 3.14 looks for signals between calls only in a loop
            time.sleep(0.1)

main(app)
"""


IMPORTS = """
import os, signal, sys

def interrupt(event, arguments):
    if event == "import" and arguments[0] == {module!r}:
        os.kill(os.getpid(), signal.SIGINT)

from deitalk.__main__ import run
sys.addaudithook(interrupt)
sys.argv = ["deitalk", "model", "export", "mel", "--onnx", "never/there.onnx"]
run()
"""
"""The program from its entry point, with Ctrl-C where it imports a module."""


@pytest.fixture(autouse=True)
def same_handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("number", BOTH)
def test_a_signal_removes_temporary_files_and_is_one_line(number, tmp_path):
    with start("-c", WRITES_FOR_EVER, "write", str(tmp_path / "out.txt")) as process:
        assert process.stdout.readline() == "writing\n"
        assert len(list(tmp_path.iterdir())) == 1
        process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert errors.strip() == f"deitalk: stopped by {number.name}"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_removes_temporary_files_and_is_one_line(tmp_path):
    with start("-c", WRITES_FOR_EVER, "write", str(tmp_path / "out.txt")) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip() == "deitalk: interrupted"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "module", ["deitalk.cli", "typer", "deitalk.cli.options", "numpy", "torch"]
)
def test_ctrl_c_in_an_import_is_one_line(module):
    """Before the command line, in it, and in what a command needs."""
    with start("-c", IMPORTS.format(module=module)) as process:
        out, errors = process.communicate(timeout=60)
    assert (process.returncode, out, errors) == (130, "", "deitalk: interrupted\n")


def answer_blocked(pipe):
    pipe.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


@pytest.mark.skipif(sys.platform == "win32", reason="this system blocks no signals")
@pytest.mark.parametrize("context", [NEW_PROCESSES, FORK_SERVER], ids=["new", "fork server"])
def test_workers_leave_ctrl_c_to_their_parent_from_their_first_import_on(context):
    worker = Worker(context, answer_blocked)
    worker.start()
    assert pickle.loads(worker.receive(60))
    worker.stop()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
def test_nohup_keeps_a_command_running(tmp_path):
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    with start("-c", ignoring + WRITES_FOR_EVER, "write", str(tmp_path / "out.txt")) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.3)
        process.terminate()
        assert process.communicate(timeout=30)[1].strip() == "deitalk: stopped by SIGTERM"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_live_recording_and_what_was_received_is_written(number, tmp_path):
    out = tmp_path / "Take_1_anna.csv"
    names = arkit_controls().names
    curves = RigCurves([[0.5] * len(names)] * 20, names, 120.0, control_set=ARKIT_ID)
    command = ("-m", "deitalk", "live", "--record", str(out), "--port", "0")
    with start(*command) as process:
        port = int(re.search(r":(\d+)", process.stderr.readline())[1])
        sent = send(curves, make_protocol("livelink", "anna", names), ("127.0.0.1", port))
        while unread(port):
            time.sleep(0.02)
        time.sleep(0.3)
        process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    assert "frames of 'anna'" in errors
    assert len(read_take(out).ticks) >= sent.n_sent  # a busy machine skips frames
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def unread(port: int) -> int:
    """Bytes that wait in the UDP socket of a port; 0 where the system does not tell."""
    table = Path("/proc/net/udp")
    rows = [line.split() for line in table.read_text().splitlines()] if table.exists() else []
    return sum(int(row[4].partition(":")[2], 16) for row in rows if row[1].endswith(f":{port:04X}"))


def test_installed_handlers_raise_once_and_then_let_the_program_clean_up():
    catch_signals()
    with pytest.raises(Terminated) as caught:
        signal.raise_signal(signal.SIGTERM)
    assert (caught.value.name, caught.value.exit_code) == ("SIGTERM", 143)
    signal.raise_signal(signal.SIGTERM)  # 5 s have not passed


def test_a_signal_is_named_where_a_library_turns_it_into_an_error(capsys):
    def swallow(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except Terminated:
            raise DeitalkError("model.safetensors: no safetensors file") from None

    with pytest.raises(SystemExit) as ended:
        main(swallow)
    assert ended.value.code == 143
    assert capsys.readouterr().err == "deitalk: stopped by SIGTERM\n"


def test_after_a_command_sigterm_ends_the_process_at_once(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["deitalk", "--version"])
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with pytest.raises(SystemExit):
        main()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize(
    ("number", "kind"), [(signal.SIGTERM, Terminated), (signal.SIGINT, KeyboardInterrupt)]
)
def test_held_signals_act_after_the_block(number, kind):
    catch_signals()
    reached = []
    with pytest.raises(kind), held() as signals:
        signal.raise_signal(number)
        reached.append(list(signals))
    assert reached == [[number]]
    with held() as signals:
        signal.raise_signal(number)
        signals.clear()  # handled: nothing is raised


def test_signals_that_nothing_handles_are_not_held():
    code = (
        "import os, signal\n"
        "from deitalk.signals import held\n"
        "with held():\n    os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == -signal.SIGTERM
