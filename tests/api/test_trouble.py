"""A full disk, and a database that is away: whose fault it is, and what goes on meanwhile."""

import errno
import json
import socket
import sqlite3
import threading
import time
from contextlib import closing, contextmanager, suppress

import pytest
import sqlalchemy as sql

from api.errors import DISK_FULL, describe, problem_for
from api.jobs.queue import Queue, new_id
from api.jobs.versions import open_database
from rig.errors import FormatError, is_disk_full
from tests.api.conftest import wav
from tests.api.database import serving_postgres
from tests.api.kill import frozen
from tests.api.server import serving, wait_for
from tests.api.test_jobs import submit, wait
from tests.api.test_queue import CALLER, WORK
from tests.test_full_disk import leave_free

BIG = wav(50.0)  # 1.6 MB


def raised(*errors):
    """The last of some errors, each raised in the handling of the one before."""
    try:
        try:
            raise errors[0]
        except Exception:
            if len(errors) == 1:
                raise
            raise errors[1] from None
    except Exception as error:
        return error


FULL = OSError(errno.ENOSPC, "No space left on device", "/data/secret.json")


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [
        (raised(FULL), 507, "disk_full"),
        (raised(OSError(errno.EDQUOT, "Disk quota exceeded")), 507, "disk_full"),
        (raised(FULL, FormatError("the file cannot be written")), 507, "disk_full"),
        (raised(FULL, ValueError("closed")), 507, "disk_full"),
        (raised(FormatError("line 3")), 422, "file_invalid"),
        (raised(OSError(errno.EACCES, "Permission denied")), 500, "internal"),
        (raised(sql.exc.OperationalError("SELECT", {}, ValueError("x"))), 503, "database_away"),
        (raised(sql.exc.InterfaceError("SELECT", {}, ValueError("x"))), 503, "database_away"),
        (raised(sql.exc.TimeoutError("pool")), 503, "database_away"),
        (raised(sql.exc.IntegrityError("SELECT", {}, ValueError("x"))), 500, "internal"),
        (raised(KeyError("x")), 500, "internal"),
    ],
)
def test_fault_is_named_and_says_when_to_come_again(caplog, error, status, code):
    problem = problem_for(error)
    assert (problem.status, problem.code) == (status, code)
    assert ("Retry-After" in problem.headers) == (status in (503, 507))
    assert "secret" not in problem.message and "secret" not in caplog.text
    assert is_disk_full(error) == (status == 507)


def test_log_has_the_reason_that_an_error_of_the_system_gives():
    assert describe(raised(FULL)) == "OSError ENOSPC in "
    assert describe(ValueError("secret")) == "ValueError in "


@contextmanager
def full(disk, free=0):
    ballast = leave_free(disk, free)
    try:
        yield
    finally:
        ballast.unlink()


@pytest.mark.parametrize("place", ["data", "storage"])
def test_full_disk_is_507_and_jobs_are_done_once_there_is_room(disk, tmp_path, place):
    """The disk of working folders, or that of the jobs' files."""
    given = {"database": f"sqlite:///{tmp_path / 'jobs.sqlite'}", "live_sessions": 0}
    given |= {"data": disk / "data"} if place == "data" else {"storage": disk / "files"}
    data = given.pop("data", tmp_path / "data")
    form = {"files": {"recording": ("a.wav", BIG)}}
    with serving(data, lease_seconds=1.0, **given) as server, server.client() as client:
        wait(client, submit(client, wav(0.3)).json()["id"])
        with full(disk):
            refused = [client.post("/v1/jobs", content=BIG), client.post("/v1/jobs", **form)]
            if place == "data":
                refused.append(client.post("/v1/animations", content=BIG))
                refused.append(client.post("/v1/conversions", files={"curves": ("a.csv", BIG)}))
            for answer in refused:
                assert (answer.status_code, answer.json()["code"]) == (507, "disk_full")
                assert int(answer.headers["retry-after"]) > 0
                assert answer.headers["content-type"] == "application/problem+json"
            assert client.get("/v1/jobs").status_code == 200
        log = server.log.read_text()
        assert "the disk is full: OSError ENOSPC in api." in log and "Traceback" not in log
        with frozen(server):
            jobs = [submit(client, wav(2.0), format="csv").json()["id"] for _ in "ab"]
            wait_for(lambda: client.get(f"/v1/jobs/{jobs[0]}").json()["status"] == "running")
            time.sleep(0.5)
            fill = full(disk)
            fill.__enter__()
        wait_for(lambda: server.log.read_text().count("the disk is full") > log.count("is full"))
        views = [client.get(f"/v1/jobs/{job}").json() for job in jobs]
        assert {view["status"] for view in views} <= {"queued", "running"}, views
        fill.__exit__(None, None, None)
        assert [wait(client, job)["status"] for job in jobs] == ["done", "done"]
        assert client.post("/v1/animations?format=csv", content=wav(1.0)).status_code == 200
        folders = {path.parent.name for path in (disk).rglob("*-inputs/*/*")}
        assert folders <= set(jobs), "what was refused is removed"


@pytest.mark.parametrize("waits", [True, False])
def test_job_is_tried_again_later_and_later_and_ends_with_the_last_reason(tmp_path, waits):
    queue = Queue(open_database(f"sqlite:///{tmp_path / 'jobs.sqlite'}"), 0.1, 3, 9)
    job_id = queue.add(new_id(), CALLER, WORK, "0" * 64, None).id
    seconds = []
    for _ in range(3):
        began = time.monotonic()
        while (job := queue.claim()) is None:
            assert time.monotonic() - began < 30
            time.sleep(0.01)
        seconds.append(time.monotonic() - began)
        queue.retry(job, problem_for(FULL), waits=waits)
    job = queue.get(job_id, CALLER)
    assert job.status == "failed" and job.error["code"] == "disk_full" and job.attempts == 3
    assert not waits or (seconds[1] > 0.05 and seconds[2] > 0.35)
    assert DISK_FULL not in json.dumps(job.error)
    queue.engine.dispose()


class Line:
    """A forwarder to a port, which can be cut or stopped."""

    def __init__(self, port: int) -> None:
        self.target, self.is_open, self.moves = port, True, threading.Event()
        self.moves.set()
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client = self.socket.accept()[0]
            except OSError:
                return
            if not self.is_open:
                client.close()
                continue
            server = socket.create_connection(("127.0.0.1", self.target))
            self.ends += [client, server]
            for pair in ((client, server), (server, client)):
                threading.Thread(target=self._copy, args=pair, daemon=True).start()

    def _copy(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while block := source.recv(65536):
                self.moves.wait()
                target.sendall(block)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    @contextmanager
    def away(self, how):
        """Cut every connection, or let nothing pass."""
        if how == "stopped":
            self.moves.clear()
        else:
            self.is_open = False
            for end in self.ends:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
        try:
            yield
        finally:
            self.is_open = True
            self.moves.set()


@pytest.fixture(scope="module")
def served(tmp_path_factory, request):
    """A server whose PostgreSQL lies behind a `Line`."""
    request.getfixturevalue("postgres")  # skips where there is none
    with serving_postgres() as url:
        port = int(url.rpartition(":")[2].partition("/")[0])
        line = Line(port)
        database = url.replace(f":{port}/", f":{line.port}/")
        with serving(
            tmp_path_factory.mktemp("away"), database=database, live_sessions=0, lease_seconds=2.0,
            requests_per_minute=10**6,
        ) as server:  # fmt: skip
            yield server, line
        line.socket.close()


def check_answers_without_database(client, job):
    calls = [("GET", "/metrics"), ("GET", "/v1/jobs"), ("GET", f"/v1/jobs/{job}"),
             ("GET", f"/v1/jobs/{job}/result"), ("GET", f"/v1/jobs/{job}/events"),
             ("POST", f"/v1/jobs/{job}/cancel"), ("DELETE", f"/v1/jobs/{job}"),
             ("POST", "/v1/jobs")]  # fmt: skip
    for method, path in calls:
        content = wav(0.3) if path == "/v1/jobs" and method == "POST" else None
        answer = client.request(method, path, content=content)
        assert (answer.status_code, answer.json()["code"]) == (503, "database_away"), path
        assert int(answer.headers["retry-after"]) > 0
        for path in ("/readyz", "/v1/models"):
            assert client.get(path).status_code == 200
    assert client.post("/v1/animations?format=csv", content=wav(0.3)).status_code == 200


@pytest.mark.parametrize("how", ["cut", "stopped"])
def test_job_routes_wait_for_a_database_that_is_away_and_animations_go_on(served, how):
    server, line = served
    with server.client() as client, server.client() as other:
        job = wait(client, submit(client, wav(0.3)).json()["id"])["id"]
        long = submit(client, wav(20.0), format="csv").json()["id"]
        seen = []

        def follow():
            with other.stream("GET", f"/v1/jobs/{long}/events") as stream:
                seen.extend(x for x in stream.iter_lines() if x.startswith("data: "))

        following = threading.Thread(target=follow)
        following.start()
        time.sleep(0.5)
        with line.away(how):
            check_answers_without_database(client, job)
        wait_for(lambda: client.get("/v1/jobs").status_code == 200)
        assert wait(client, long)["status"] == "done"
        following.join(60)
        assert not following.is_alive() and json.loads(seen[-1][6:])["status"] == "done"
        assert client.get("/metrics").status_code == 200
    assert "Traceback" not in server.log.read_text()


def test_locked_table_of_sqlite_is_503_for_what_writes_alone(server, client):
    job = wait(client, submit(client, wav(0.3)).json()["id"])["id"]
    table = sqlite3.connect(server.log.with_name("jobs.sqlite"), isolation_level=None)
    with closing(table):
        table.execute("BEGIN IMMEDIATE")
        for answer in (submit(client, wav(0.3)), client.delete(f"/v1/jobs/{job}")):
            assert (answer.status_code, answer.json()["code"]) == (503, "database_away")
            assert int(answer.headers["retry-after"]) > 0
        for path in ("/metrics", "/v1/jobs", f"/v1/jobs/{job}/result"):
            assert client.get(path).status_code == 200
        assert client.post("/v1/animations", content=wav(0.3)).status_code == 200
        table.execute("ROLLBACK")
    assert wait(client, submit(client, wav(0.3)).json()["id"])["status"] == "done"
