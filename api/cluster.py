"""The same application on the machines of a Ray cluster, by Ray Serve.

Each replica is the whole application with its own worker processes. Ray listens, passes requests
and sockets on, and adds and removes replicas by the number of requests at work.
"""

import logging
import os
import signal
import sys
import threading
from typing import Any

from api.serving import KEEP_ALIVE_SECONDS, check_port, log_to_stderr, print_settings
from api.settings import Settings
from deitalk.errors import ConfigError, DeitalkError, MissingError
from rig.errors import one_line

NAME = "deitalk"
STOP_SECONDS = 15.0


def run(settings: Settings) -> None:
    """Print the settings and serve by Ray until SIGINT or SIGTERM.

    Raises
    ------
    MissingError
        If Ray Serve is not installed.
    ConfigError
        If a setting is wrong, the port is taken, or machines of a cluster would have jobs of
        their own.
    DeitalkError
        If no cluster answers, Ray Serve runs on it already, or the replicas do not start.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        from ray import serve
    except ImportError as error:
        raise MissingError(
            f"serving by Ray needs Ray Serve ({error}); install it by `pip install 'deitalk[ray]'`"
        ) from None
    settings.check()
    print_settings(settings)
    logging.getLogger("ray.serve").setLevel(logging.WARNING)
    _join(settings)
    # Return an event that SIGINT and SIGTERM set; after Ray, which takes the signals itself.
    ending = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.set())
    try:
        _check_shared(settings, len(ray.nodes()))
        _check_free(serve.status())
        check_port(settings)
    except BaseException:
        ray.shutdown()
        raise
    try:
        serve.start(
            proxy_location="HeadOnly",
            http_options={
                "host": settings.host,
                "port": settings.port,
                "keep_alive_timeout_s": KEEP_ALIVE_SECONDS,
            },
        )
        serve.run(deployment(settings), name=NAME, logging_config={"enable_access_log": False})
        sys.stderr.write(f"ready on {settings.host} port {settings.port}\n")
        ending.wait()
    except RuntimeError as error:
        raise DeitalkError(one_line(f"Ray Serve: {error}")) from None
    finally:
        serve.shutdown()
        ray.shutdown()


def deployment(settings: Settings) -> Any:
    """Return the application as a deployment of Ray Serve, with its settings bound.

    A replica takes `replica_cpus` processors and `replica_gpus` GPUs, which may be a fraction: two
    replicas of 0.5 share one. Ray names the GPU to the replica and its workers by
    ``CUDA_VISIBLE_DEVICES``.
    """
    from ray import serve

    given = settings.model_dump()

    def build() -> Any:
        """Make the application on the machine of a replica."""
        from api.app import create_app

        log_to_stderr(settings.log)
        return create_app(Settings(**given))

    return serve.deployment(
        serve.ingress(build)(),
        name=NAME,
        ray_actor_options={
            "num_cpus": settings.replica_cpus,
            "num_gpus": settings.replica_gpus,
        },
        max_ongoing_requests=settings.connections,
        autoscaling_config={
            "min_replicas": settings.replicas,
            "max_replicas": max(settings.most_replicas, settings.replicas),
            "target_ongoing_requests": settings.workers,
            "upscale_delay_s": settings.scale_up_seconds,
            "downscale_delay_s": settings.scale_down_seconds,
        },
        graceful_shutdown_timeout_s=STOP_SECONDS,
    ).bind()


def _join(settings: Settings) -> None:
    """Join the cluster of the settings or of this machine, or start one here."""
    import ray

    address = settings.ray_address or os.environ.get("RAY_ADDRESS") or None
    try:
        ray.init(
            address=address, log_to_driver=False, logging_level="ERROR",
            **({} if address else {"include_dashboard": False}),
        )  # fmt: skip
    except (ConnectionError, RuntimeError, ValueError) as error:
        text = one_line(f"Ray at {address or 'this machine'}: {error}")
        raise DeitalkError(f"{text}; check the address, or start a cluster") from None


def _check_free(status: Any) -> None:
    """Refuse a cluster on which Ray Serve runs: its address and its programs are another's."""
    if status.applications or status.proxies:
        names = ", ".join(status.applications) or "no application"
        raise DeitalkError(
            f"Ray Serve runs on this cluster already ({names}); end it by `serve shutdown`, or use "
            "another cluster"
        )


def _check_shared(settings: Settings, machines: int) -> None:
    """Refuse a cluster whose machines would each have jobs of their own."""
    if machines > 1 and not (settings.database and settings.storage):
        raise ConfigError(
            f"the cluster has {machines} machines, and jobs lie on this one only; set `database` "
            "and `storage` to places that all of them reach"
        )
