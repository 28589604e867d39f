"""The tables of jobs, and the steps from one schema of them to the next.

::

    queued ── claim ──> running ── finish ──> done | failed | cancelled
       │                   └─ lease over ──> running again, of another holder
       └────────────── cancel ─────────────> cancelled

Every change is one UPDATE whose WHERE names the state it starts from: of two that compete, one
changes a row and the other sees that it changed none.
"""

import json
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sql
from sqlalchemy import (
    BigInteger,
    Column,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)

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
