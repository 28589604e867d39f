"""Files of jobs in every kind of store, and what is removed of them."""

import os
import subprocess
import sys
import time
import uuid
from pathlib import Path
from types import SimpleNamespace

import pytest

from api.compute.pool import SERVER_PREFIX, Stage
from api.errors import Problem
from api.guard.keys import Caller
from api.guard.metrics import Metrics
from api.guard.traces import Traces
from api.jobs.queue import Queue, new_id
from api.jobs.runner import Runner, remove_lost, remove_old
from api.jobs.store import Store
from api.jobs.table import JOBS
from api.jobs.versions import open_database
from api.settings import SCOPES, Settings
from tests.api.server import ROOT, wait_for

CALLER = Caller("farm", SCOPES, 3, 600)
WORK = {"order": {"kind": "animation"}, "format": "json"}


@pytest.fixture(params=["folder", "memory", "s3"])
def store(request, tmp_path):
    if request.param == "folder":
        return Store(str(tmp_path / "files"))
    if request.param == "s3":
        return Store(f"{request.getfixturevalue('bucket')}/{uuid.uuid4().hex}")
    return Store(f"memory://{uuid.uuid4().hex}")


@pytest.fixture
def queue(tmp_path):
    made = Queue(open_database(f"sqlite:///{tmp_path / 'jobs.sqlite'}"), 60.0, 3, 5)
    yield made
    made.engine.dispose()


def add(queue, store, tmp_path, content=b"sound"):
    folder = tmp_path / "sent"
    folder.mkdir(exist_ok=True)
    (folder / "recording").write_bytes(content)
    job_id = new_id()
    store.put_folder(folder, job_id)
    return queue.add(job_id, CALLER, WORK, "0" * 64, None)


def test_files_come_back_as_they_went(store, tmp_path):
    sent, back = tmp_path / "sent", tmp_path / "back"
    sent.mkdir()
    back.mkdir()
    (sent / "recording").write_bytes(bytes(range(256)) * 9000)
    (sent / "emotion.csv").write_text("time")
    store.put_folder(sent, "a")
    store.get_folder("a", back)
    assert {path.name: path.read_bytes() for path in back.iterdir()} == {
        path.name: path.read_bytes() for path in sent.iterdir()
    }
    name = store.put_result(sent / "recording", "a", "holder")
    content = (sent / "recording").read_bytes()
    assert b"".join(store.read(name, 0, len(content), len(content))) == content
    assert b"".join(store.read(name, 999, 1_500_000, len(content))) == content[999:1_500_000]
    assert store.jobs() == {"a"} and store.age("a") < 60
    store.remove("a")
    assert store.jobs() == set()


def finished(queue, store, tmp_path, n_bytes):
    job = add(queue, store, tmp_path)
    claimed = queue.claim()
    assert claimed is not None and claimed.id == job.id
    name = store.put_result(tmp_path / "sent" / "recording", job.id, claimed.holder)
    assert queue.finish(claimed, name, n_bytes, {"notes": [], "facts": {}})
    return job.id


def test_old_jobs_and_the_oldest_beyond_the_size_are_removed(queue, store, tmp_path):
    settings = Settings(data=tmp_path, keep_days=1, keep_mb=10)
    old, first, second = (finished(queue, store, tmp_path, 6 * 2**20) for _ in range(3))
    with queue.engine.begin() as connection:
        yesterday = JOBS.update().where(JOBS.c.id == old).values(finished=time.time() - 90_000)
        connection.execute(yesterday)
    waiting = add(queue, store, tmp_path).id
    assert remove_old(queue, store, settings) == 2
    assert store.jobs() == {second, waiting}
    assert {job.id for job in queue.newest(CALLER, None, 9, None)} == {second, waiting}
    assert first not in store.jobs()


def test_files_of_no_job_are_removed_after_a_while(queue, store, tmp_path, monkeypatch):
    (tmp_path / "recording").write_bytes(b"x")
    store.put_result(tmp_path / "recording", "lost", "holder")
    remove_lost(queue, store)
    assert store.jobs() == {"lost"}  # a request may be about to add its job
    monkeypatch.setattr(store, "age", lambda job_id: 1000.0)
    remove_lost(queue, store)
    assert store.jobs() == set()


def test_files_on_their_way_are_not_removed(queue, store, tmp_path, monkeypatch):
    """The search for lost files may run when a request has made its folder and no file yet."""
    put_file = store.files.put_file

    def search_then_put(source, target):
        remove_lost(queue, store)
        put_file(source, target)

    monkeypatch.setattr(store.files, "put_file", search_then_put)
    sent = tmp_path / "sent"
    sent.mkdir()
    (sent / "recording").write_bytes(b"x")
    store.put_folder(sent, "new")
    assert store.jobs() == {"new"}


def test_full_queues_refuse_jobs(queue, store, tmp_path):
    for _ in range(3):
        queue.check_room(CALLER)
        add(queue, store, tmp_path)
    with pytest.raises(Problem) as refused:
        queue.check_room(CALLER)
    assert refused.value.status == 429
    for _ in range(2):
        add(queue, store, tmp_path)
    with pytest.raises(Problem) as refused:
        queue.check_room(Caller("other", SCOPES, 3, 600))
    assert refused.value.status == 503


@pytest.mark.parametrize(("cancels", "status"), [(False, "done"), (True, "cancelled")])
def test_lease_is_renewed_while_a_result_is_copied(tmp_path, cancels, status):
    """A slow store made the job another's three times; then it failed."""

    class Watched(Queue):
        def renew(self, job, progress):
            renewed.append(super().renew(job, progress))
            return renewed[-1]

    class Slow(Store):
        def put_result(self, path, job_id, holder):
            if cancels:
                queue.cancel(queue.get(job_id, CALLER))
            wait_for(lambda: (not cancels) in renewed)
            return super().put_result(path, job_id, holder)

    def run(order, seconds, progress, stopped):
        out = Path(order["folder"], "out")
        out.mkdir()
        (out / "recording.json").write_text("{}")
        return {"file": "out/recording.json"}

    queue = Watched(open_database(f"sqlite:///{tmp_path / 'jobs.sqlite'}"), 0.2, 3, 5)
    renewed, store = [], Slow(str(tmp_path / "files"))
    job_id = add(queue, store, tmp_path).id
    settings = Settings(job_workers=0)
    runner = Runner(queue, store, Stage(tmp_path / "stage"), {}, settings, Metrics(), Traces())
    runner._work_on(queue.claim(), SimpleNamespace(run=run))
    assert queue.get(job_id, CALLER).status == status
    runner.stage.close()
    queue.engine.dispose()


def test_cancelling_a_job_that_runs_waits_for_its_holder(queue, store, tmp_path):
    waiting = add(queue, store, tmp_path)
    running = queue.claim()
    assert running.id == waiting.id and queue.renew(running, 0.25)
    queue.cancel(running)
    assert queue.get(running.id, CALLER).status == "running"
    assert not queue.renew(running, 0.5)
    assert queue.confirm_cancelled(running) and not queue.confirm_cancelled(running)
    assert queue.get(running.id, CALLER).status == "cancelled"
    assert not queue.remove_ended([add(queue, store, tmp_path).id])
    assert queue.remove_ended([running.id]) == 1


def test_clearing_up_leaves_the_user_s_own_folders(tmp_path, queue):
    """Storage and data may be folders that hold old ``results/``, ``inputs/`` and ``stage/``."""
    day = 30 * 86_400
    for name in ("results/shot_1/take.csv", "inputs/anna/line.wav", "stage/set/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("mine")
        for path in (tmp_path / name, (tmp_path / name).parent):
            os.utime(path, (time.time() - day, time.time() - day))
    outside = tmp_path / "stage" / f"{SERVER_PREFIX}link"
    outside.symlink_to(tmp_path / "inputs")
    remove_old(queue, Store(str(tmp_path)), Settings())
    remove_lost(queue, Store(str(tmp_path)))
    Stage(tmp_path / "stage").close()
    left = {path.name for path in tmp_path.rglob("*.*") if "sqlite" not in path.name}
    assert left - {".deitalk.lock"} == {"take.csv", "line.wav", "notes.txt"}


MAKE = "import sys; from pathlib import Path; from api.compute.pool import Stage\n"
MAKE += "stage = Stage(Path(sys.argv[1])); print(stage.make(), flush=True); sys.stdin.read()"


def test_folders_of_a_running_server_stay_and_those_of_a_killed_one_go(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", MAKE, tmp_path],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    ) as other:  # fmt: skip
        theirs = Path(other.stdout.readline().strip())
        (theirs / "recording").write_bytes(b"speech")
        long_ago = time.time() - 30 * 86_400
        for path in (theirs, theirs.parent):
            os.utime(path, (long_ago, long_ago))
        second = Stage(tmp_path)
        ours = second.make()
        assert (theirs / "recording").read_bytes() == b"speech"
        other.kill()
        other.wait()
    third = Stage(tmp_path)
    assert not theirs.parent.exists() and ours.exists()
    for stage in (second, third):
        stage.close()
    assert not list(tmp_path.glob(f"{SERVER_PREFIX}*"))
