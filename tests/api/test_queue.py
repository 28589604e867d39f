"""The table of jobs in SQLite and in PostgreSQL, on a real server that the test starts."""

import os
import pwd
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
import sqlalchemy as sql

from api.errors import Problem
from api.guard.keys import Caller
from api.jobs.queue import Queue, new_id
from api.jobs.table import JOBS, METADATA, open_database
from api.settings import SCOPES
from tests.api.conftest import wav
from tests.api.server import free_port, serving
from tests.api.test_jobs import submit, wait

CALLER = Caller("farm", SCOPES, 10, 600)


def programs() -> Path | None:
    found = shutil.which("initdb")
    places = [Path(found).resolve().parent] if found else []  # not a link into a private folder
    places += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    return next((place for place in places if (place / "initdb").exists()), None)


@pytest.fixture(scope="module")
def postgres():
    """URL of an empty database; PostgreSQL refuses to run as root."""
    place = programs()
    if place is None:
        pytest.skip("needs PostgreSQL (Debian's package postgresql)")
    user = None
    if os.geteuid() == 0:
        user = next((name for name in ("postgres", "nobody") if _exists(name)), None)
    folder = Path(tempfile.mkdtemp(prefix="deitalk-pg-", dir="/tmp"))
    if user:
        shutil.chown(folder, user)
    given = {"user": user} if user else {}
    data, port = folder / "data", free_port()

    def run(*command: str) -> None:
        subprocess.run(
            command, check=True, cwd=folder, stdout=subprocess.DEVNULL, timeout=120, **given
        )

    run(str(place / "initdb"), "-D", str(data), "-U", "deitalk", "-A", "trust", "--no-sync")
    options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1 -c fsync=off"
    run(str(place / "pg_ctl"), "-D", str(data), "-w", "-l", str(folder / "log"), "-o", options,
        "start")  # fmt: skip
    try:
        yield f"postgresql+psycopg://deitalk@127.0.0.1:{port}/postgres"
    finally:
        run(str(place / "pg_ctl"), "-D", str(data), "-m", "immediate", "stop")
        shutil.rmtree(folder)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, tmp_path):
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    return request.getfixturevalue("postgres")


def _exists(name: str) -> bool:
    try:
        pwd.getpwnam(name)
    except KeyError:
        return False
    return True


def test_servers_that_start_together_share_a_new_table(database):
    """The second one makes the table between the first one's look and its own making."""
    engines = [sql.create_engine(database)]
    JOBS.drop(engines[0], checkfirst=True)

    def meanwhile(*given, **more):
        if len(engines) == 1:
            engines.append(sql.create_engine(database))
            METADATA.create_all(engines[1])

    sql.event.listen(JOBS, "before_create", meanwhile)
    try:
        engines.append(open_database(database))
    finally:
        sql.event.remove(JOBS, "before_create", meanwhile)
    assert len(engines) == 3
    assert all(sql.inspect(engine).has_table(JOBS.name) for engine in engines)
    for engine in engines:
        engine.dispose()


def test_two_queues_share_jobs_without_doubling_one(database):
    queues = [Queue(open_database(database), 60.0, 3, 100) for _ in range(2)]
    work = {"order": {"kind": "animation"}, "format": "json"}
    ids = {queues[0].add(new_id(), CALLER, work, "0" * 64, None, None).id for _ in range(9)}
    claimed = [queues[k % 2].claim() for k in range(10)]
    assert claimed[-1] is None and {job.id for job in claimed[:-1]} == ids
    job = claimed[0]
    assert queues[1].renew(job, 0.5) and queues[0].finish(job, "r", 1, {"notes": []})
    assert not queues[1].finish(job, "r", 1, {}) and not queues[1].renew(job, 0.6)
    for other in claimed[1:-1]:
        assert queues[0].fail(other, Problem(422, "x"))
    assert queues[0].counts("farm") == {"done": 1, "failed": 8}
    for queue in queues:
        queue.engine.dispose()


def test_lease_that_is_over_passes_the_job_on_until_its_attempts_are_used(database):
    queue = Queue(open_database(database), -1.0, 2, 100)
    work = {"order": {"kind": "animation"}, "format": "json"}
    job_id = queue.add(new_id(), CALLER, work, "1" * 64, "key", None).id
    first, second = queue.claim(), queue.claim()
    assert first.id == second.id == job_id and first.holder != second.holder
    assert not queue.finish(first, "r", 1, {})  # the second holder has it
    assert queue.claim() is None
    assert queue.get(job_id, CALLER).error["code"] == "worker_lost"
    again = queue.add(new_id(), CALLER, work, "1" * 64, "key", None)
    assert again.id == job_id
    queue.engine.dispose()


def test_service_keeps_its_jobs_in_postgresql(postgres, tmp_path):
    with serving(tmp_path / "a", database=postgres) as server, server.client() as client:
        job = wait(client, submit(client, recording=wav(1.0), format="csv").json()["id"])
        assert job["status"] == "done"
        assert len(client.get(job["result"]).text.splitlines()) == 31
    assert not (tmp_path / "a" / "jobs.sqlite").exists()


@pytest.mark.slow
def test_two_servers_share_jobs_by_postgresql_and_a_bucket(postgres, bucket, tmp_path):
    """One server accepts and answers, the other carries out."""
    shared = {"database": postgres, "storage": f"{bucket}/service"}
    with (
        serving(tmp_path / "a", job_workers=0, **shared) as front,
        serving(tmp_path / "b", **shared),
        front.client() as client,
    ):
        for seconds in (1, 2):  # the second job is beside files that the first server has listed
            job = wait(client, submit(client, recording=wav(seconds), format="csv").json()["id"])
            assert job["status"] == "done", job
            assert len(client.get(job["result"]).text.splitlines()) == 30 * seconds + 1
        assert client.delete(f"/v1/jobs/{job['id']}").status_code == 204
        assert client.get(job["result"]).status_code == 404
