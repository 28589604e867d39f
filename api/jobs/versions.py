"""The version of the jobs' tables in a database, and the steps to that of this program."""

from importlib.resources import files
from typing import Any

import sqlalchemy as sql
from alembic.config import Config
from alembic.runtime.environment import EnvironmentContext
from alembic.script import Script, ScriptDirectory
from sqlalchemy import (
    Connection,
    Engine,
    event,
)

from api.jobs.table import JOBS, METADATA
from deitalk.errors import ConfigError

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
    with engine.begin() as connection:  # servers that start together take it one after another
        if engine.dialect.name == "sqlite":
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        elif engine.dialect.name == "postgresql":
            connection.execute(sql.select(sql.func.pg_advisory_xact_lock(LOCK)))
        _upgrade(connection, migrate=migrate)
    return engine


def _upgrade(connection: Connection, *, migrate: bool) -> None:
    folder = str(files("api.jobs.migrations"))
    steps = ScriptDirectory(folder, version_locations=[folder])
    newest = int(steps.get_current_head() or 0)
    inspect = sql.inspect(connection)
    version = int(inspect.has_table(JOBS.name))  # 0 without tables; the first wrote no number
    if inspect.has_table(VERSIONS):
        number = connection.execute(sql.text(f"SELECT version_num FROM {VERSIONS}")).scalar()
        version = int(number or 0)
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


def _tune_sqlite(connection: Any, record: Any) -> None:
    """Readers beside one writer; a writer waits for another; kept after kill and power cut."""
    cursor = connection.cursor()
    for setting in ("journal_mode=WAL", "synchronous=FULL", f"busy_timeout={1000 * AWAY_SECONDS}"):
        cursor.execute(f"PRAGMA {setting}")
    cursor.close()
