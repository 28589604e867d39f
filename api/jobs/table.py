"""The tables of jobs, and the steps from one schema of them to the next.

::

    queued ── claim ──> running ── finish ──> done | failed | cancelled
       │                   └─ lease over ──> running again, of another holder
       └────────────── cancel ─────────────> cancelled

Every change is one UPDATE whose WHERE names the state it starts from: of two that compete, one
changes a row and the other sees that it changed none.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import sqlalchemy as sql
from alembic.config import Config
from alembic.runtime.environment import EnvironmentContext
from alembic.script import Script, ScriptDirectory
from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    event,
)

from deitalk.errors import ConfigError

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
ENDED = (DONE, FAILED, CANCELLED)

METADATA = MetaData()
JOBS = Table(
    "deitalk_jobs",
    METADATA,
    Column("id", String(64), primary_key=True),
    Column("owner", String(64), nullable=False, index=True),
    Column("status", String(16), nullable=False, index=True),
    Column("work", Text, nullable=False),
    Column("created", Float, nullable=False, index=True),
    Column("started", Float),
    Column("finished", Float, index=True),
    Column("progress", Float, nullable=False, default=0.0),
    Column("attempts", Integer, nullable=False, default=0),
    Column("holder", String(64), nullable=False, default=""),
    Column("lease", Float, nullable=False, default=0.0),
    Column("cancel", Integer, nullable=False, default=0),
    Column("ends", Integer, nullable=False, default=0),
    Column("result", String(200)),
    Column("result_bytes", BigInteger, nullable=False, default=0),
    Column("answer", Text),
    Column("error", Text),
    Column("idempotency", String(300), unique=True),
    Column("digest", String(64), nullable=False),
)
USAGE = Table(
    "deitalk_usage",
    METADATA,
    Column("owner", String(64), primary_key=True),
    Column("hour", Integer, primary_key=True, autoincrement=False),
    Column("seconds", Float, nullable=False),
)
"""Seconds of sound that each key had animated in each hour since 1970."""
DUTIES = Table(
    "deitalk_duties",
    METADATA,
    Column("name", String(40), primary_key=True),
    Column("until", Float, nullable=False),
)
"""What one server does for all, and until when no other does."""


@dataclass(frozen=True)
class Job:
    """One row, with its JSON read.

    Attributes
    ----------
    id : str
        43 random letters.
    owner : str
        Name of the key it was made with.
    status : str
        `QUEUED`, `RUNNING` or one of `ENDED`.
    work : dict
        The order, and the format of its result.
    created, started, finished : float or None
        Seconds since 1970.
    progress : float
        0 to 1.
    attempts : int
        Times that a worker began it.
    result : str or None
        Name of the result in the store.
    answer : dict or None
        Notes and facts of the result.
    error : dict or None
        Code, message, detail.
    """

    id: str
    owner: str
    status: str
    work: dict[str, Any]
    created: float
    started: float | None
    finished: float | None
    progress: float
    attempts: int
    holder: str
    digest: str
    result: str | None
    result_bytes: int
    answer: dict[str, Any] | None
    error: dict[str, Any] | None

    @property
    def has_ended(self) -> bool:
        """Whether nothing will change any more."""
        return self.status in ENDED


def job_of(row: "sql.Row[Any]") -> Job:
    """Return a row as a job."""
    values = {name: row._mapping[name] for name in Job.__dataclass_fields__}
    for name in ("work", "answer", "error"):
        values[name] = None if values[name] is None else json.loads(values[name])
    return Job(**values)


# The version of the jobs' tables in a database, and the steps to that of this program.


VERSIONS = "deitalk_schema"
"""Table with the version."""
AWAY_SECONDS = 5
"""Time after which a connection that is not made, or a lock that is not given, is an error."""
LOCK = 0x6465_6974
"""Number of PostgreSQL's lock while a step is taken."""


def open_database(url: str, *, migrate: bool = False) -> Engine:
    """Return an engine for a SQLAlchemy URL whose tables have this program's schema.

    Servers of one schema and of the next work beside each other, for a rolling update.

    Parameters
    ----------
    url : str
        Of SQLAlchemy.
    migrate : bool
        Take all steps; else only those that are safe beside servers at work.

    Raises
    ------
    ConfigError
        If a step is left that is not safe, or the tables are two versions ahead, or of a version
        without steps to this one.
    """
    dialect = sql.make_url(url).get_backend_name()
    connect = {"connect_timeout": AWAY_SECONDS} if dialect == "postgresql" else {}
    pool = {} if ":memory:" in url or url == "sqlite://" else {"pool_timeout": AWAY_SECONDS}
    engine = sql.create_engine(url, pool_pre_ping=True, connect_args=connect, **pool)
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _tune_sqlite)
    with _locked(engine) as connection:
        _upgrade(connection, migrate=migrate)
    return engine


def _upgrade(connection: Connection, *, migrate: bool) -> None:
    steps = ScriptDirectory(str(files("api.jobs.migrations")), version_locations=[
        str(files("api.jobs.migrations"))
    ])  # fmt: skip
    newest = int(steps.get_current_head() or 0)
    version = _version(connection)
    if 0 < version < int(steps.get_base() or 0):
        raise ConfigError(
            f"the database has schema {version}, of a version before the first release; remove its "
            "tables, or use another database"
        )
    if version > newest + 1:
        raise ConfigError(
            f"the database has schema {version}, this program knows {newest}; serve with a newer "
            "version of deitalk"
        )
    for step in steps.walk_revisions():
        if int(step.revision) > version and not (migrate or is_safe(step)):
            raise ConfigError(
                f"the database has schema {version}, this program needs {newest}; stop the "
                "servers and run `deitalk serve --migrate`"
            )
    if version >= newest:
        return

    def path(revision: Any, context: Any) -> Any:
        return steps._upgrade_revs("head", str(version) if version else "base")

    with EnvironmentContext(Config(), steps, fn=path) as environment:
        environment.configure(
            connection=connection, target_metadata=METADATA, version_table=VERSIONS
        )
        environment.run_migrations()


def is_safe(step: Script) -> bool:
    """Whether a server may take a step when it starts."""
    return bool(step.module.SAFE)


def _version(connection: Connection) -> int:
    """The version of the tables, 0 if there are none; the first one wrote no number."""
    inspect = sql.inspect(connection)
    if not inspect.has_table(VERSIONS):
        return 1 if inspect.has_table(JOBS.name) else 0
    return int(connection.execute(sql.text(f"SELECT version_num FROM {VERSIONS}")).scalar() or 0)


@contextmanager
def _locked(engine: Engine) -> Iterator[Connection]:
    """A transaction that servers which start together take one after another."""
    with engine.begin() as connection:
        if engine.dialect.name == "sqlite":
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        elif engine.dialect.name == "postgresql":
            connection.execute(sql.select(sql.func.pg_advisory_xact_lock(LOCK)))
        yield connection


def _tune_sqlite(connection: Any, record: Any) -> None:
    """Readers beside one writer; a writer waits for another; kept after kill and power cut."""
    cursor = connection.cursor()
    for setting in ("journal_mode=WAL", "synchronous=FULL", f"busy_timeout={1000 * AWAY_SECONDS}"):
        cursor.execute(f"PRAGMA {setting}")
    cursor.close()
