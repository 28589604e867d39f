"""Killed and stopped builds: no process and no temporary file stays, the next build completes them."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.corpus.build import Shard, build
from deitalk.research.corpus.engines import available_engines
from deitalk.research.tests.corpus.test_build import digests
from rig.errors import TargetError
from tests.interrupt import count_writes, kill_at_write

pytestmark = pytest.mark.skipif(
    available_engines()["espeak"] is not None, reason=str(available_engines()["espeak"])
)
SHARDS = [Shard(f"espeak-{i:03d}", "espeak", 2.0, i) for i in range(2)]
AT_WORK = """
import time
from deitalk.research.corpus.pool import worker_pool
with worker_pool(2) as pool:
    pool.submit(time.sleep, 0).result()
    for _ in range(2):
        pool.submit(time.sleep, 600)
    print("at work", flush=True)
    time.sleep(600)
"""
LONG = """
from pathlib import Path
from deitalk.signals import catch_signals
from deitalk.research.corpus.build import Shard, build
import sys
catch_signals()
shards = [Shard(f"espeak-{i:03d}", "espeak", 120.0, i) for i in range(4)]
build(Path(sys.argv[1]), shards, workers=2)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("built") / "corpus"
    build(out, SHARDS, workers=1)
    return out


def test_kill_9_ends_the_workers_too():
    command = [sys.executable, "-c", AT_WORK]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"at work\n"
        process.kill()
        # The workers share this pipe: it ends with the last of them.
        process.communicate(timeout=300)


def test_sigterm_ends_a_build_within_its_shards_and_leaves_no_temporary_file(tmp_path):
    out = tmp_path / "corpus"
    with subprocess.Popen(
        [sys.executable, "-c", LONG, str(out)], stderr=subprocess.PIPE
    ) as process:
        end = time.monotonic() + 600
        while not all(list(out.glob(f"audio/espeak-00{shard}-*.flac")) for shard in range(2)):
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, output = process.communicate(timeout=300)
    assert b"Terminated" in output and output.count(b"Error") == 0, output.decode()
    assert [path.name for path in out.rglob(".*")] == [".deitalk-manifest.json"]
    assert not list(out.glob("*.csv")) and not list(out.glob("shards/*.csv"))


def check_kills(tmp_path: Path, built: Path, choose) -> None:
    total = count_writes(tmp_path / "whole", lambda: build(tmp_path / "whole", SHARDS, workers=1))
    for number in choose(total):
        out = tmp_path / f"killed-{number}"
        assert kill_at_write(number, out, lambda: build(out, SHARDS, workers=1)) >= number  # noqa: B023
        build(out, SHARDS, workers=1)
        assert digests(out) == digests(built), f"killed at write {number} of {total}"


def test_a_build_killed_at_some_writes_is_equal_after_the_next(tmp_path, built):
    check_kills(
        tmp_path, built, lambda total: np.random.default_rng(0).choice(total, 3, replace=False) + 1
    )


@pytest.mark.slow
def test_a_build_killed_at_any_write_is_equal_after_the_next(tmp_path, built):
    check_kills(tmp_path, built, lambda total: range(1, total + 1))


def test_folder_of_another_origin_is_refused_and_kept(tmp_path):
    (tmp_path / "clips.csv").write_text("mine")
    with pytest.raises(TargetError, match=r"holds files that deitalk did not write \(clips\.csv\)"):
        build(tmp_path, SHARDS, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["clips.csv"]


def test_edited_table_of_clips_is_refused_before_any_work_and_kept(tmp_path):
    out = tmp_path / "corpus"
    build(out, SHARDS[:1], workers=1)
    (out / "clips.csv").write_text("mine")
    with pytest.raises(TargetError, match=r"clips\.csv was changed since deitalk wrote it"):
        build(out, SHARDS, workers=1)
    assert (out / "clips.csv").read_text() == "mine"
    assert not (out / "shards" / "espeak-001.csv").exists()


def test_dataset_of_an_earlier_version_is_continued(tmp_path, built):
    out = tmp_path / "corpus"
    build(out, SHARDS, workers=1)
    (out / ".deitalk-manifest.json").unlink()
    build(out, SHARDS, workers=1)
    assert digests(out) == digests(built)
    (out / ".deitalk-manifest.json").unlink()
    (out / "clips.csv").write_text("mine")
    with pytest.raises(TargetError, match="was not written by deitalk and would be replaced"):
        build(out, SHARDS, workers=1)


def test_damaged_plan_is_an_error_of_one_line(tmp_path):
    build(tmp_path, SHARDS[:1], workers=1)
    (tmp_path / "shards" / "plan.json").write_text("[1")
    with pytest.raises(DataError, match=r"plan\.json: damaged; build in another folder"):
        build(tmp_path, SHARDS[:1], workers=1)
