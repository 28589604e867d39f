"""Changes of the table of jobs; each safe beside any number of other servers."""

import json
import secrets
from collections.abc import Mapping
from time import time
from typing import Any

import sqlalchemy as sql
from sqlalchemy import Engine
from sqlalchemy.exc import IntegrityError

from api.errors import Problem
from api.guard.keys import Caller
from api.jobs.table import (
    CANCELLED,
    DONE,
    DUTIES,
    ENDED,
    FAILED,
    JOBS,
    QUEUED,
    RUNNING,
    USAGE,
    Job,
    job_of,
)

FAIR_SECONDS = 60.0
"""Time in which work counts: of two keys that wait, the one with less for its share is next."""
BATCH = 500
"""Jobs that one statement removes or looks up."""
HOUR = 3600
LOST = Problem(503, "the worker ended in every attempt", "worker_lost")


def new_id() -> str:
    """Return an id of 256 random bits."""
    return secrets.token_urlsafe(32)


class Queue:
    """The table of jobs in one database.

    Parameters
    ----------
    engine : Engine
        From `api.jobs.versions.open_database`.
    lease_seconds : float
        Time after which a job whose holder was not seen is given to another.
    attempts : int
        Times that a job is begun before it counts as failed.
    most : int
        Most jobs that are queued or run, of all callers.
    shares : mapping of str to float, optional
        Of the workers, by owner, where many wait; 1 for others.
    """

    def __init__(
        self,
        engine: Engine,
        lease_seconds: float,
        attempts: int,
        most: int,
        shares: Mapping[str, float] | None = None,
    ) -> None:
        self.engine, self.lease_seconds = engine, lease_seconds
        self.attempts, self.most, self.shares = attempts, most, shares or {}

    def known(self, caller: Caller, idempotency: str | None, digest: str) -> Job | None:
        """Return the job of an idempotency key; Problem 409 if it was of another request."""
        if idempotency is None:
            return None
        job = self._one(JOBS.c.idempotency == f"{caller.name}:{idempotency}")
        if job is not None and job.digest != digest:
            raise Problem(
                409, "the Idempotency-Key was used with another request; use a new key",
                "idempotency_conflict",
            )  # fmt: skip
        return job

    def check_room(self, caller: Caller) -> None:
        """Refuse a job beyond the caller's limit (Problem 429) or the service's (503)."""
        active = self.counts()
        if active.get(QUEUED, 0) + active.get(RUNNING, 0) >= self.most:
            raise Problem(
                503,
                "too many jobs are queued; try again later",
                "busy",
                None,
                {"Retry-After": "30"},
            )
        own = self.counts(caller.name)
        if own.get(QUEUED, 0) + own.get(RUNNING, 0) >= caller.jobs:
            raise Problem(
                429, f"{caller.jobs} jobs of this key are queued or run; wait for one to end",
                headers={"Retry-After": "30"},
            )  # fmt: skip

    def add(
        self,
        job_id: str,
        caller: Caller,
        work: dict[str, Any],
        digest: str,
        idempotency: str | None,
    ) -> Job:
        """Accept a job whose files are in the store; of two with one key the first is returned."""
        row = {
            "id": job_id,
            "owner": caller.name,
            "status": QUEUED,
            "work": json.dumps(work),
            "created": time(),
            "digest": digest,
            "idempotency": None if idempotency is None else f"{caller.name}:{idempotency}",
        }
        try:
            with self.engine.begin() as connection:
                connection.execute(sql.insert(JOBS).values(**row))
        except IntegrityError:
            job = self.known(caller, idempotency, digest)
            if job is None:
                raise
            return job
        return self.get(job_id, caller)

    def get(self, job_id: str, caller: Caller) -> Job:
        """Return a caller's own job; Problem 404 if there is none."""
        job = self._one(sql.and_(JOBS.c.id == job_id, JOBS.c.owner == caller.name))
        if job is None:
            raise Problem(404, "there is no such job", "job_unknown")
        return job

    def newest(
        self, caller: Caller, status: str | None, limit: int, before: float | None
    ) -> list[Job]:
        """Return a caller's jobs, the newest first."""
        where = [JOBS.c.owner == caller.name]
        if status is not None:
            where.append(JOBS.c.status == status)
        if before is not None:
            where.append(JOBS.c.created < before)
        query = sql.select(JOBS).where(*where).order_by(JOBS.c.created.desc()).limit(limit)
        with self.engine.connect() as connection:
            return [job_of(row) for row in connection.execute(query)]

    def counts(self, owner: str | None = None) -> dict[str, int]:
        """Return the number of jobs of each status."""
        query = sql.select(JOBS.c.status, sql.func.count()).group_by(JOBS.c.status)
        if owner is not None:
            query = query.where(JOBS.c.owner == owner)
        with self.engine.connect() as connection:
            return {status: count for status, count in connection.execute(query)}

    def claim(self) -> Job | None:
        """Take a job that waits or whose holder is gone; None if there is none.

        The owner with least work in the last minute for its share is next, with its oldest job.
        """
        while True:
            now = time()
            is_free = sql.and_(JOBS.c.status.in_((QUEUED, RUNNING)), JOBS.c.lease < now)
            owner = self._next_owner(is_free, now)
            if owner is None:
                return None
            job = self._one(sql.and_(is_free, JOBS.c.owner == owner), order=JOBS.c.created)
            if job is None:  # another server has it
                continue
            same = [JOBS.c.id == job.id, JOBS.c.status == job.status, JOBS.c.holder == job.holder]
            if job.attempts >= self.attempts:
                self._end([*same, is_free], FAILED, error=json.dumps(LOST.content))
                continue
            holder = new_id()
            values = {
                "status": RUNNING, "holder": holder, "lease": now + self.lease_seconds,
                "attempts": job.attempts + 1, "started": now,
            }  # fmt: skip
            if self._update([*same, is_free], values):
                return self._one(JOBS.c.id == job.id)

    def _next_owner(self, is_free: Any, now: float) -> str | None:
        begin, job = now - FAIR_SECONDS, JOBS.c
        oldest = sql.select(job.owner, sql.func.min(job.created)).where(is_free)
        seen = sql.case((job.lease < now, job.lease), else_=now)  # its holder may be gone
        end = sql.case((job.status == RUNNING, seen), else_=job.finished)
        worked = end - sql.case((job.started > begin, job.started), else_=begin)
        with self.engine.connect() as connection:
            waits = [tuple(row) for row in connection.execute(oldest.group_by(job.owner))]
            if len(waits) < 2:
                return waits[0][0] if waits else None
            query = (
                sql.select(job.owner, sql.func.sum(worked))
                .where(job.owner.in_([owner for owner, _ in waits]), job.started.is_not(None))
                .where(
                    sql.or_(
                        sql.and_(job.status == RUNNING, job.lease > begin), job.finished > begin
                    )
                )
            )
            seconds = {o: n for o, n in connection.execute(query.group_by(job.owner))}
        return str(
            min(waits, key=lambda w: (seconds.get(w[0], 0.0) / self.shares.get(w[0], 1.0), w[1]))[0]
        )

    def renew(self, job: Job, progress: float) -> bool:
        """Keep a job that is worked on; False if it was cancelled or is another's."""
        values = {"lease": time() + self.lease_seconds, "progress": progress}
        return self._update([*self._mine(job), JOBS.c.cancel == 0], values)

    def release(self, job: Job) -> None:
        """Put a job back that is worked on, because the server stops."""
        self._put_back(job, attempts=max(job.attempts - 1, 0), lease=0.0)

    def retry(self, job: Job, problem: Problem, *, waits: bool = True) -> None:
        """Put a job back after an attempt that failed by no fault of the job; the last one ends it.

        If it `waits`, the next attempt begins after a lease, and then after four times as long.
        """
        if job.attempts >= self.attempts:
            self.fail(job, problem)
            return
        seconds = self.lease_seconds * 4 ** (job.attempts - 1) if waits else 0.0
        self._put_back(job, lease=time() + seconds)

    def _put_back(self, job: Job, **values: Any) -> None:
        self._update(self._mine(job), {"status": QUEUED, "holder": "", "progress": 0.0} | values)

    def finish(self, job: Job, result: str, n_bytes: int, answer: dict[str, Any]) -> bool:
        """End a job with its result; False if it is another's by now."""
        return self._end(
            self._mine(job), DONE, result=result, result_bytes=n_bytes, progress=1.0,
            answer=json.dumps(answer),
        )  # fmt: skip

    def fail(self, job: Job, problem: Problem) -> bool:
        """End a job with an error."""
        return self._end(self._mine(job), FAILED, error=json.dumps(problem.content))

    def cancel(self, job: Job) -> None:
        """End a job that waits, or have the holder end one that runs."""
        if not self._end([JOBS.c.id == job.id, JOBS.c.status == QUEUED], CANCELLED):
            self._update([JOBS.c.id == job.id, JOBS.c.status == RUNNING], {"cancel": 1})

    def confirm_cancelled(self, job: Job) -> bool:
        """End a job whose cancellation its holder has seen."""
        return self._end([*self._mine(job), JOBS.c.cancel == 1], CANCELLED)

    def expired(self, oldest: float, room: int, rooms: Mapping[str, int]) -> list[str]:
        """Return ids of ended jobs that are no longer kept, at most `BATCH`.

        Parameters
        ----------
        oldest : float
            Jobs that ended before, seconds since 1970, are not kept.
        room : int
            Bytes of the newest results of an owner that are kept.
        rooms : mapping of str to int
            The same of owners who have another.
        """
        job = JOBS.c
        newer = sql.func.sum(job.result_bytes).over(
            partition_by=job.owner, order_by=[job.finished.desc(), job.id]
        )
        own = [(job.owner == owner, n_bytes) for owner, n_bytes in rooms.items()]
        limit = sql.case(*own, else_=room) if own else sql.literal(room, sql.BigInteger)
        ended = (
            sql.select(job.id, job.finished, newer.label("newer"), limit.label("room"))
            .where(job.status.in_(ENDED))
            .subquery()
        )
        query = sql.select(ended.c.id).where(
            sql.or_(ended.c.finished < oldest, ended.c.newer > ended.c.room)
        )
        with self.engine.connect() as connection:
            return list(connection.execute(query.limit(BATCH)).scalars())

    def remove_ended(self, ids: list[str]) -> int:
        """Delete rows of jobs that have ended; return their number."""
        where = (JOBS.c.id.in_(ids), JOBS.c.status.in_(ENDED))
        with self.engine.begin() as connection:
            return connection.execute(sql.delete(JOBS).where(*where)).rowcount

    def known_of(self, ids: list[str]) -> set[str]:
        """Return those of some ids that are in the table."""
        found: set[str] = set()
        with self.engine.connect() as connection:
            for begin in range(0, len(ids), BATCH):
                where = JOBS.c.id.in_(ids[begin : begin + BATCH])
                found |= set(connection.execute(sql.select(JOBS.c.id).where(where)).scalars())
        return found

    def take_duty(self, name: str, seconds: float) -> bool:
        """Whether this server does, for `seconds`, what one server does for all."""
        now = time()
        values = {"name": name, "until": now + seconds}
        with self.engine.begin() as connection:
            due = sql.update(DUTIES).where(DUTIES.c.name == name, DUTIES.c.until < now)
            if connection.execute(due.values(**values)).rowcount == 1:
                return True
            if connection.execute(sql.select(DUTIES).where(DUTIES.c.name == name)).first():
                return False
        try:
            with self.engine.begin() as connection:
                connection.execute(sql.insert(DUTIES).values(**values))
        except IntegrityError:  # another server was first
            return False
        return True

    def use(self, owner: str, seconds: float) -> None:
        """Count sound that a key had animated."""
        values = {"owner": owner, "hour": int(time() // HOUR)}
        where = (USAGE.c.owner == owner, USAGE.c.hour == values["hour"])
        more = sql.update(USAGE).where(*where).values(seconds=USAGE.c.seconds + seconds)
        with self.engine.begin() as connection:
            if connection.execute(more).rowcount == 1:
                return
        try:
            with self.engine.begin() as connection:
                connection.execute(sql.insert(USAGE).values(**values, seconds=seconds))
        except IntegrityError:  # another server was first
            with self.engine.begin() as connection:
                connection.execute(more)

    def check_quota(self, caller: Caller) -> None:
        """Refuse a caller whose sound of this hour is used: Problem 429."""
        if not caller.audio_seconds_per_hour:
            return
        hour, rest = divmod(time(), HOUR)
        where = (USAGE.c.owner == caller.name, USAGE.c.hour == int(hour))
        with self.engine.connect() as connection:
            used = connection.execute(sql.select(USAGE.c.seconds).where(*where)).scalar() or 0.0
        if used >= caller.audio_seconds_per_hour:
            raise Problem(
                429,
                f"the key's {caller.audio_seconds_per_hour} seconds of sound an hour are used; "
                "wait for the next hour", "quota_used",
                headers={"Retry-After": str(int(HOUR - rest) + 1)},
            )  # fmt: skip

    def forget_usage(self) -> None:
        """Remove counts of sound that are a day old."""
        with self.engine.begin() as connection:
            connection.execute(sql.delete(USAGE).where(USAGE.c.hour < time() // HOUR - 24))

    def _mine(self, job: Job) -> list[Any]:
        return [JOBS.c.id == job.id, JOBS.c.status == RUNNING, JOBS.c.holder == job.holder]

    def _end(self, where: list[Any], status: str, **values: Any) -> bool:
        ending = {"status": status, "finished": time(), "ends": JOBS.c.ends + 1}
        return self._update(where, ending | values)

    def _update(self, where: list[Any], values: dict[str, Any]) -> bool:
        with self.engine.begin() as connection:
            return connection.execute(sql.update(JOBS).where(*where).values(**values)).rowcount == 1

    def _one(self, where: Any, order: Any = None) -> Job | None:
        query = sql.select(JOBS).where(where).order_by(order).limit(1)
        with self.engine.connect() as connection:
            row = connection.execute(query).first()
        return None if row is None else job_of(row)
