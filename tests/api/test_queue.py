"""The table of jobs in SQLite and in PostgreSQL, on a real server that the test starts."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import sqlalchemy as sql
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from typer.testing import CliRunner

from api.errors import Problem
from api.guard.keys import Caller
from api.jobs import versions
from api.jobs.queue import Queue, new_id
from api.jobs.table import DUTIES, JOBS, METADATA
from api.jobs.versions import VERSIONS, open_database
from api.settings import SCOPES
from deitalk.cli import app as cli
from deitalk.errors import ConfigError
from tests.api.conftest import bearer, wav
from tests.api.server import serving
from tests.api.test_jobs import submit, wait
from tests.errors import one_line

CALLER = Caller("farm", SCOPES, 10, 600)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, tmp_path):
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    return request.getfixturevalue("postgres")


@pytest.fixture
def empty(database):
    """A database without tables, which is left so."""
    engine = sql.create_engine(database)

    def clear():
        with engine.begin() as connection:
            METADATA.drop_all(connection)
            connection.execute(sql.text(f"DROP TABLE IF EXISTS {VERSIONS}"))

    clear()
    yield engine
    clear()
    engine.dispose()


def url_of(engine):
    return engine.url.render_as_string(hide_password=False)


def test_servers_that_start_together_make_the_tables_once(empty):
    with ThreadPoolExecutor(4) as threads:
        engines = list(threads.map(open_database, [url_of(empty)] * 4))
    for engine in engines:
        with engine.connect() as connection:
            assert connection.scalar(sql.text(f"SELECT count(*) FROM {VERSIONS}")) == 1
        engine.dispose()


def test_steps_of_the_schema_give_the_tables_that_the_program_knows(empty):
    """Alembic's own comparison; SQLite's integers have 64 bits under every name."""
    open_database(url_of(empty)).dispose()
    with empty.connect() as connection:
        options = {"version_table": VERSIONS, "compare_type": empty.dialect.name != "sqlite"}
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, METADATA) == []


@pytest.mark.parametrize("version", [1, 2])
def test_tables_of_versions_before_the_first_release_are_refused_in_one_line(empty, version):
    """The tables of schema 1 came without a number."""
    with empty.begin() as connection:
        connection.execute(sql.text("CREATE TABLE deitalk_jobs (id VARCHAR(64))"))
        if version > 1:
            connection.execute(sql.text(f"CREATE TABLE {VERSIONS} (version_num VARCHAR(32))"))
            connection.execute(sql.text(f"INSERT INTO {VERSIONS} VALUES ('{version}')"))
    with one_line(ConfigError, f"schema {version}", "another database"):
        open_database(url_of(empty))


def test_results_over_four_gigabytes_are_counted(queue):
    put(queue, "farm")
    job = queue.claim()
    assert queue.finish(job, "r", 5 * 2**30, {})
    assert queue.get(job.id, CALLER).result_bytes == 5 * 2**30


def test_schema_two_versions_ahead_is_refused_and_one_ahead_is_not(empty):
    open_database(url_of(empty)).dispose()
    for ahead, is_refused in ((1, False), (2, True)):
        with empty.begin() as connection:
            connection.execute(sql.text(f"UPDATE {VERSIONS} SET version_num = '{3 + ahead}'"))
        if is_refused:
            with pytest.raises(ConfigError, match=r"schema 5, this program knows 3"):
                open_database(url_of(empty))
        else:
            open_database(url_of(empty)).dispose()


def test_step_that_is_not_safe_waits_for_the_command(empty, monkeypatch, tmp_path):
    monkeypatch.setattr(versions, "is_safe", lambda step: False)
    with pytest.raises(ConfigError, match="serve --migrate"):
        open_database(url_of(empty))
    monkeypatch.setenv("DEITALK_DATABASE", url_of(empty))
    monkeypatch.setenv("DEITALK_DATA", str(tmp_path))
    done = CliRunner().invoke(cli, ["serve", "--migrate"])
    assert done.exit_code == 0, done.output
    open_database(url_of(empty)).dispose()


def test_two_queues_share_jobs_without_doubling_one(empty):
    queues = [Queue(open_database(url_of(empty)), 60.0, 3, 100) for _ in range(2)]
    work = {"order": {"kind": "animation"}, "format": "json"}
    ids = {queues[0].add(new_id(), CALLER, work, "0" * 64, None).id for _ in range(9)}
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


def test_lease_that_is_over_passes_the_job_on_until_its_attempts_are_used(empty):
    queue = Queue(open_database(url_of(empty)), -1.0, 2, 100)
    work = {"order": {"kind": "animation"}, "format": "json"}
    job_id = queue.add(new_id(), CALLER, work, "1" * 64, "key").id
    first, second = queue.claim(), queue.claim()
    assert first.id == second.id == job_id and first.holder != second.holder
    assert not queue.finish(first, "r", 1, {})  # the second holder has it
    assert queue.claim() is None
    assert queue.get(job_id, CALLER).error["code"] == "worker_lost"
    again = queue.add(new_id(), CALLER, work, "1" * 64, "key")
    assert again.id == job_id
    queue.engine.dispose()


@pytest.fixture
def queue(empty):
    made = Queue(open_database(url_of(empty)), 60.0, 3, 10_000, {"big": 3.0})
    yield made
    made.engine.dispose()


WORK = {"order": {"kind": "animation"}, "format": "json"}


def put(queue, owner, **values):
    """Add a job; `values` of its row replace those of a new one."""
    job_id = queue.add(new_id(), replace(CALLER, name=owner), WORK, "0" * 64, None).id
    if values:
        with queue.engine.begin() as connection:
            connection.execute(sql.update(JOBS).where(JOBS.c.id == job_id).values(**values))
    return job_id


def test_key_with_least_work_for_its_share_is_next(queue):
    """Work of the last minute: a 30 s, b 20 s (40 of its 60 s are older), big 45 s of a share of 3."""
    now = time.time()
    for owner, began, ended in (("a", 30, 0), ("b", 100, 40), ("big", 50, 5), ("none", 900, 800)):
        put(queue, owner, status="done", started=now - began, finished=now - ended)
    for owner in ("a", "a", "b", "big", "none"):
        put(queue, owner)
    order = ["none", "big", "b", "a", "a"]  # 0, 15, 20, 30
    assert [queue.claim().owner for _ in order] == order
    assert queue.claim() is None


def test_key_whose_worker_was_killed_is_not_held_back_by_the_time_until_another_takes_its_job(
    queue,
):
    """Five seconds of work, then nothing for forty: less than the ten of another key."""
    now = time.time()
    put(queue, "a", status="running", started=now - 45, lease=now - 40, attempts=1)
    put(queue, "b", status="done", started=now - 10, finished=now)
    put(queue, "b")
    job = queue.claim()
    assert job.owner == "a" and job.attempts == 2 and job.started >= now


def test_one_key_s_thousand_jobs_do_not_keep_another_s_waiting(queue):
    for _ in range(30):
        put(queue, "a")
    put(queue, "b")
    owners = []
    for _ in range(3):
        job = queue.claim()
        owners.append(job.owner)
        with queue.engine.begin() as connection:  # ten seconds of work
            times = {"started": time.time() - 10, "finished": time.time(), "status": "done"}
            connection.execute(sql.update(JOBS).where(JOBS.c.id == job.id).values(**times))
    assert owners == ["a", "b", "a"]


def test_sound_of_an_hour_is_counted_by_all_servers_and_refused_beyond(queue):
    caller = replace(CALLER, audio_seconds_per_hour=100)
    queue.use("farm", 60.0)
    queue.check_quota(caller)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(lambda _: queue.use("farm", 10.0), range(4)))
    with pytest.raises(Problem, match="100 seconds of sound") as refused:
        queue.check_quota(caller)
    assert refused.value.status == 429 and 1 <= int(refused.value.headers["Retry-After"]) <= 3600
    queue.check_quota(replace(caller, name="other"))
    queue.check_quota(replace(caller, audio_seconds_per_hour=0))


def test_duty_is_one_server_s_until_its_time_is_over(queue):
    other = Queue(open_database(url_of(queue.engine)), 60.0, 3, 10)
    with ThreadPoolExecutor(2) as threads:
        taken = list(threads.map(lambda q: q.take_duty("x", 60.0), [queue, other] * 4))
    assert taken.count(True) == 1
    with queue.engine.begin() as connection:
        connection.execute(sql.update(DUTIES).values(until=0.0))
    assert other.take_duty("x", 60.0) and not queue.take_duty("x", 60.0)
    other.engine.dispose()


def test_results_of_one_key_do_not_push_out_another_s(queue):
    """Rooms of 10 bytes, of `big` 20; the newest are kept."""
    now = time.time()
    kept = []
    for owner, n_bytes, is_kept in (
        ("a", 6, False), ("a", 5, True), ("a", 5, True), ("b", 9, True), ("big", 1, False),
        ("big", 12, True), ("big", 8, True),
    ):  # fmt: skip
        now += 1
        job_id = put(queue, owner, status="done", finished=now, result_bytes=n_bytes)
        kept += [job_id] if is_kept else []
    old = put(queue, "c", status="failed", finished=1.0)
    running = put(queue, "a", status="running", lease=now + 60)
    expired = queue.expired(100.0, 10, {"big": 20})
    assert len(expired) == 3 and old in expired
    assert queue.remove_ended([*expired, running]) == 3
    assert queue.known_of([*kept, *expired, running]) == {*kept, running}


def test_retention_of_twenty_thousand_jobs_takes_three_seconds_of_this_process_at_most(queue):
    """0.1.0 loaded every row each minute: 28 s."""
    rows = [
        {"id": f"{k:043}", "owner": f"o{k % 4}", "status": "done", "work": "x" * 2000,
         "created": 1.0, "finished": time.time() + k, "result_bytes": 10, "digest": "0"}
        for k in range(20_000)
    ]  # fmt: skip
    with queue.engine.begin() as connection:
        connection.execute(sql.insert(JOBS), rows)
    began = time.process_time()
    assert queue.expired(0.0, 10**9, {}) == []
    assert len(queue.known_of([row["id"] for row in rows])) == 20_000
    assert time.process_time() - began < 3
    assert len(queue.expired(0.0, 10 * 4900, {})) == 400


def test_service_keeps_its_jobs_in_postgresql(postgres, observed):
    with observed.server.client(headers=bearer("farm")) as client:
        job = wait(client, submit(client, recording=wav(1.0), format="csv").json()["id"])
        assert job["status"] == "done"
        assert len(client.get(job["result"]).text.splitlines()) == 31
    assert not list(observed.server.log.parent.rglob("jobs.sqlite"))


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
