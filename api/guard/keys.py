"""API keys, how often each may be used, and how many places its requests may hold.

A key is 256 random bits, so that its SHA-256 is enough to store: nobody can try so many.
"""

import hashlib
import secrets
from collections import Counter, OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from ipaddress import ip_network
from time import monotonic

from api.errors import Problem
from api.settings import SCOPES, Scope, Settings

KEY_PREFIX = "dk_"
MOST_PLACES = 10**6
MOST_CALLERS = 10_000
"""Callers whose rates are kept; the one that was not seen longest is forgotten."""


@dataclass(frozen=True)
class Caller:
    """Sender of a request; fields but `id` and `address` are those of `api.settings.ApiKey`.

    Attributes
    ----------
    name : str
        Of the key; ``local`` where no keys are needed.
    id : str
        First letters of the key's SHA-256, for the log; empty without keys.
    address : str
        Where no keys are needed, that of the client.
    """

    name: str
    scopes: tuple[Scope, ...]
    jobs: int
    requests_per_minute: int
    id: str = ""
    concurrent: int = MOST_PLACES
    live: int = MOST_PLACES
    share: float = 1.0
    audio_seconds_per_hour: int = 0
    address: str = ""

    @property
    def holder(self) -> str:
        """Name under which requests are counted: the key's, or without keys the address's."""
        return f"address {self.address}" if self.address else f"key {self.name}"


def new_key() -> tuple[str, str]:
    """Return a new key and its SHA-256."""
    key = KEY_PREFIX + secrets.token_urlsafe(32)
    return key, digest_of(key)


def digest_of(key: str) -> str:
    """SHA-256 of a key, in hexadecimal."""
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


class KeyRing:
    """The keys of the settings.

    Parameters
    ----------
    settings : Settings
        Without keys every request of this machine has all scopes.
    """

    def __init__(self, settings: Settings) -> None:
        known = {field.name for field in fields(Caller)}
        self._callers = {
            key.sha256: Caller(id=key.sha256[:8], **key.model_dump(include=known))
            for key in settings.keys
        }
        self._local = Caller("local", SCOPES, settings.queued_jobs, settings.requests_per_minute)

    def caller(self, key: str | None, address: str) -> Caller:
        """Return who a key belongs to; without keys the client of an address.

        Raises
        ------
        Problem
            401 without a key or with an unknown one, if there are keys.
        """
        if not self._callers:
            return replace(self._local, address=address)
        if not key:
            raise _refused("send a key as `Authorization: Bearer <key>`", "key_missing")
        caller = self._callers.get(digest_of(key))
        if caller is None:
            raise _refused("the key is unknown", "key_unknown")
        return caller


def require(caller: Caller, scope: Scope) -> None:
    """Refuse a caller whose key has not the scope: Problem 403."""
    if scope not in caller.scopes:
        raise Problem(403, f"the key has not the scope {scope}", "scope_missing")


class Rates:
    """Requests per minute of each caller: a bucket that fills evenly, a tenth of it at once."""

    def __init__(self) -> None:
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, name: str, per_minute: float) -> None:
        """Count one request.

        Raises
        ------
        Problem
            429 with ``Retry-After`` if the bucket is empty.
        """
        now, size = monotonic(), max(per_minute / 10, 5.0)
        left, last = self._buckets.pop(name, (size, now))
        left = min(size, left + (now - last) * per_minute / 60)
        self._buckets[name] = (max(left - 1, 0.0) if left >= 1 else left, now)
        if len(self._buckets) > MOST_CALLERS:
            self._buckets.popitem(last=False)
        if left < 1:
            wait = max(1, round((1 - left) * 60 / per_minute))
            raise Problem(
                429,
                f"more than {per_minute:g} requests a minute; wait {wait} s",
                headers={"Retry-After": str(wait)},
            )


class Places:
    """Places that requests hold while they are at work.

    A holder may take a further one while it holds fewer than are free: alone half of them, n
    greedy holders n of every n + 1. There is always one for whoever has none.

    Parameters
    ----------
    most : int
        Places.
    """

    def __init__(self, most: int) -> None:
        self.most, self.held = most, Counter[str]()

    @property
    def taken(self) -> int:
        """Places that are held."""
        return self.held.total()

    def check(self, holder: str, limit: int = MOST_PLACES) -> None:
        """Refuse a holder another place.

        Raises
        ------
        Problem
            503 if all are held, 429 if the holder has its part of them or as many as `limit`.
        """
        own, free = self.held[holder], self.most - self.taken
        headers = {"Retry-After": "1", "Connection": "close"}
        if free <= 0:
            raise Problem(503, "the service is busy; try again in a second", "busy", None, headers)
        if own >= min(limit, free):
            kind = holder.partition(" ")[0]
            text = f"this {kind} has {own} at work, and may have no more now; wait for one to end"
            raise Problem(429, text, headers=headers)

    @contextmanager
    def hold(self, holder: str, limit: int = MOST_PLACES) -> Iterator[None]:
        """Hold a place during the block; raises what `check` does."""
        self.check(holder, limit)
        self.held[holder] += 1
        try:
            yield
        finally:
            self.held[holder] -= 1
            if not self.held[holder]:
                del self.held[holder]


def client_of(address: str) -> str:
    """The address of a client; of IPv6 the network of 64 bits, whose addresses are one client's."""
    try:
        return str(ip_network(f"{address}/64", strict=False)) if ":" in address else address
    except ValueError:
        return address


def _refused(message: str, code: str) -> Problem:
    return Problem(401, message, code, headers={"WWW-Authenticate": "Bearer"})
