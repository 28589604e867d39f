"""One POST when a job has ended, to hosts that the settings allow and to no other.

The address comes from a request: without a list of hosts it would let a caller reach any machine
that this one can reach. Redirects are not followed, and proxies of the environment not used.
"""

import asyncio
import hmac
import json
import logging
from base64 import b64encode
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import islice
from time import time
from urllib.parse import urlsplit

import httpx

from api.errors import Problem
from api.jobs.queue import Queue
from api.jobs.table import Job

SECONDS = 10.0
"""Time of one delivery, from the look-up of the host to the status of the answer."""
AT_ONCE = 16
log = logging.getLogger("deitalk.service")


class Webhooks:
    """Sends what `Queue.claim_webhook` gives, signed as Standard Webhooks 1.0 says.

    Parameters
    ----------
    queue : Queue
    hosts : tuple of str
        Allowed ``host`` (ports 80 and 443) or ``host:port``.
    secrets : mapping of str to bytes
        Secret of each owner who has one; webhooks of others are not signed.
    """

    def __init__(self, queue: Queue, hosts: tuple[str, ...], secrets: Mapping[str, bytes]) -> None:
        self.queue, self.hosts, self.secrets = queue, hosts, secrets

    def deliver(self) -> int:
        """Send every webhook that is due, `AT_ONCE` at a time; return how many were taken."""
        due = list(islice(iter(self.queue.claim_webhook, None), AT_ONCE))
        return sum(asyncio.run(self._send_all(due))) if due else 0

    async def _send_all(self, jobs: list[Job]) -> list[bool]:
        async with httpx.AsyncClient(follow_redirects=False, trust_env=False) as client:
            return await asyncio.gather(*(self._send(client, job) for job in jobs))

    async def _send(self, client: httpx.AsyncClient, job: Job) -> bool:
        """Send one within `SECONDS`, whatever the receiver does; its answer's body is not read."""
        try:
            url = check_webhook(str(job.webhook), self.hosts)
            body, headers = message_of(job, self.secrets.get(job.owner), time())
            async with asyncio.timeout(SECONDS):
                async with client.stream("POST", url, content=body, headers=headers) as answer:
                    is_taken = answer.is_success
            if is_taken:
                await asyncio.to_thread(self.queue.webhook_sent, job)
            return is_taken
        except (httpx.HTTPError, httpx.InvalidURL, Problem, TimeoutError) as error:
            log.warning("a webhook was not taken: %s", type(error).__name__)
            return False


def message_of(job: Job, secret: bytes | None, now: float) -> tuple[bytes, dict[str, str]]:
    """Return the body and headers of a job's webhook (standardwebhooks.com, 1.0).

    Parameters
    ----------
    job : Job
        That has ended; every try has the same ``webhook-id``.
    secret : bytes or None
        Of the signature; None leaves it out.
    now : float
        Seconds since 1970.
    """
    ended = datetime.fromtimestamp(job.finished or now, UTC).isoformat()
    data = {"id": job.id, "status": job.status, "job": f"/v1/jobs/{job.id}"}
    body = json.dumps({"type": f"job.{job.status}", "timestamp": ended, "data": data}).encode()
    headers = {
        "content-type": "application/json",
        "webhook-id": f"msg_{job.id}",
        "webhook-timestamp": str(int(now)),
    }
    if secret is not None:
        signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
        digest = hmac.digest(secret, signed, "sha256")
        headers["webhook-signature"] = f"v1,{b64encode(digest).decode()}"
    return body, headers


def check_webhook(url: str, hosts: tuple[str, ...]) -> str:
    """Return an address that may be called.

    Raises
    ------
    Problem
        403 if its host is not allowed, 422 if it is no address.
    """
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError:
        raise Problem(422, "webhook must be an http or https address", "webhook_invalid") from None
    is_address = parts.scheme in ("http", "https") and host and len(url) <= 500
    if not is_address or parts.username or parts.password or not url.isprintable() or "\\" in url:
        raise Problem(422, "webhook must be an http or https address", "webhook_invalid")
    default = {"http": 80, "https": 443}[parts.scheme]
    allowed = host in hosts if port in (None, default) else f"{host}:{port}" in hosts
    if not allowed:
        raise Problem(403, "the webhook's host is not among webhook_hosts", "webhook_forbidden")
    return url
