"""Worker processes of a batch: results of all orders, and processes that end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deitalk.batch.processes import CHUNK_BYTES, ENDED, Order, Outcome, Workers, chunks
from deitalk.errors import CheckpointError, DeitalkError

ROOT = Path(__file__).resolve().parents[3]


class Echo:
    """Returns each order; ends the process at those that say so."""

    def __call__(self, orders):
        for order in orders:
            if order.audio == "end":
                os._exit(3)
            if order.audio.startswith("once ") and not os.path.exists(order.audio[5:]):
                open(order.audio[5:], "w").close()
                os._exit(3)
            yield [Outcome(order.output, "done", seconds=float(os.getpid()))]


def no_model():
    raise CheckpointError("there is no model; name another")


def no_memory():
    os._exit(9)


def outcomes(orders, count=2, make=Echo):
    with Workers(count, make) as workers:
        return {o.output: o for found in workers.run(orders) for o in found}


def test_every_order_is_answered_and_the_line_that_ends_its_process_fails_alone(tmp_path):
    once = f"once {tmp_path / 'flag'}"
    orders = [Order(str(i), {3: "end", 5: once}.get(i, "a")) for i in range(40)]
    found = outcomes(orders)
    assert sorted(found, key=int) == [str(i) for i in range(40)]
    failed = [n for n, o in found.items() if o.status != "done"]
    assert failed == ["3"] and found["3"].error == ENDED


def test_chunks_are_bounded_and_in_order():
    orders = [Order(str(i), "a", size=1.0) for i in range(100)]
    sizes = [len(chunk) for chunk in chunks(orders, 2)]
    assert sizes == [12] * 8 + [4]
    assert [o for chunk in chunks(orders, 2) for o in chunk] == orders
    large = [Order(str(i), "a", size=0.6 * CHUNK_BYTES) for i in range(20)]
    assert [len(chunk) for chunk in chunks(large, 1)] == [1] * 20
    assert [len(chunk) for chunk in chunks(orders[:3], 2)] == [1] * 3


@pytest.mark.parametrize(
    ("make", "error"), [(no_model, CheckpointError), (no_memory, DeitalkError)]
)
def test_process_without_model_is_one_error(make, error):
    with pytest.raises(error, match=r"no model|while loading"):
        outcomes([Order("0", "a")], 1, make)


def test_processes_end_with_a_killed_parent(tmp_path):
    code = (
        "from tests.deitalk.batch.test_processes import *\n"
        "if __name__ == '__main__':\n"
        "    with Workers(1, Echo) as w:\n"
        "        print(int(next(w.run([Order('0', 'a')]))[0].seconds), flush=True)\n"
        "        time.sleep(60)\n"
    )
    path = tmp_path / "parent.py"
    path.write_text(code)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, path], stdout=subprocess.PIPE, env=environment
    ) as parent:
        worker = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    end = time.monotonic() + 60
    while is_there(worker):
        assert time.monotonic() < end
        time.sleep(0.05)


def is_there(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True
