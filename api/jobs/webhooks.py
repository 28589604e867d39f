"""One POST when a job has ended, to hosts that the settings allow and to no other.

The address comes from a request: without a list of hosts it would let a caller reach any machine
that this one can reach. Redirects are not followed, and proxies of the environment not used.
"""

import logging
from urllib.parse import urlsplit

import httpx

from api.errors import Problem
from api.jobs.queue import Queue

SECONDS = 10.0
log = logging.getLogger("deitalk.service")


class Webhooks:
    """Sends what `Queue.claim_webhook` gives.

    Parameters
    ----------
    queue : Queue
    hosts : tuple of str
        Allowed ``host`` (ports 80 and 443) or ``host:port``.
    """

    def __init__(self, queue: Queue, hosts: tuple[str, ...]) -> None:
        self.queue, self.hosts = queue, hosts

    def deliver(self) -> int:
        """Send every webhook that is due; return how many were taken."""
        taken = 0
        while (job := self.queue.claim_webhook()) is not None:
            body = {"id": job.id, "status": job.status, "job": f"/v1/jobs/{job.id}"}
            try:
                check_webhook(str(job.webhook), self.hosts)
                with httpx.Client(
                    timeout=SECONDS, follow_redirects=False, trust_env=False
                ) as client:
                    answer = client.post(str(job.webhook), json=body)
                if answer.is_success:
                    self.queue.webhook_sent(job)
                    taken += 1
            except (httpx.HTTPError, httpx.InvalidURL, Problem) as error:
                log.warning("a webhook was not taken: %s", type(error).__name__)
        return taken


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
