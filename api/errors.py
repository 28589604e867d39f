"""Errors as answers: problem JSON of a code, a message and a detail.

::

    class of the error            status
    Problem                       its own
    AudioError … TopologyError    422, the request's content
    CheckpointError               404, no such model
    MissingError                  503, a program that this machine lacks
    ExistsError                   409
    the disk is full              507
    the database does not answer  503
    anything else                 500, without its text
"""

import errno
import json
import logging
import re
import secrets
from collections.abc import Mapping
from typing import Any

from deitalk.errors import (
    AudioError,
    CheckpointError,
    ConfigError,
    DataError,
    EmotionError,
    MissingError,
)
from rig.errors import (
    ControlError,
    CurveError,
    ExistsError,
    FormatError,
    MeshError,
    TopologyError,
    UserError,
    is_disk_full,
    one_line,
)

log = logging.getLogger("deitalk.service")

MEDIA_TYPE = "application/problem+json"
DISK_FULL = "DiskFull"
"""Stands for the class of an error below which `is_disk_full`."""
FULL_TEXT = "the server's disk is full; try again later"
AWAY = ("sqlalchemy.exc.OperationalError", "sqlalchemy.exc.InterfaceError",
        "sqlalchemy.exc.TimeoutError")  # fmt: skip
"""Errors of a database that does not answer; worker processes do without sqlalchemy."""
RETRY = {"Retry-After": "5"}
CODES: dict[str, tuple[int, str]] = {
    AudioError.__name__: (422, "audio_unusable"),
    EmotionError.__name__: (422, "emotion_invalid"),
    ConfigError.__name__: (422, "option_invalid"),
    DataError.__name__: (422, "data_invalid"),
    CheckpointError.__name__: (422, "model_unfit"),
    MissingError.__name__: (503, "program_missing"),
    ControlError.__name__: (422, "control_invalid"),
    CurveError.__name__: (422, "curves_invalid"),
    FormatError.__name__: (422, "file_invalid"),
    MeshError.__name__: (422, "mesh_invalid"),
    TopologyError.__name__: (422, "mesh_invalid"),
    ExistsError.__name__: (409, "exists"),
}
STATUS_CODES = {
    400: "request_malformed",
    401: "key_missing",
    403: "forbidden",
    404: "not_found",
    405: "method_not_allowed",
    409: "conflict",
    410: "gone",
    413: "too_large",
    415: "type_unsupported",
    416: "range_invalid",
    422: "request_invalid",
    429: "too_many_requests",
    503: "unavailable",
    507: "disk_full",
}
_PATH = re.compile(r"(?<![\w:/.])/(?!v1/)(?:[\w.+-]+/)+[\w.+-]*")
"""Absolute paths of files; routes and URLs are no match."""


class Problem(Exception):
    """An answer other than the one expected.

    Parameters
    ----------
    status : int
        Of HTTP.
    message : str
        One line: the value, the rule, the way out.
    code : str
        Machine-readable; by default that of the status.
    detail : Any
        More, as JSON; None if there is none.
    headers : mapping
        Of the answer, such as ``Retry-After``.
    """

    def __init__(
        self,
        status: int,
        message: str,
        code: str = "",
        detail: Any = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(message)
        self.status, self.message = status, without_paths(one_line(message))
        self.code = code or STATUS_CODES.get(status, "error")
        self.detail, self.headers = detail, dict(headers or {})

    @property
    def content(self) -> dict[str, Any]:
        """Body of the answer."""
        return {"code": self.code, "message": self.message, "detail": self.detail}

    @property
    def body(self) -> bytes:
        """Body of the answer as JSON."""
        return json.dumps(self.content).encode()


def problem_of(error: UserError) -> Problem:
    """Return the answer to an error that a user can correct."""
    return named_problem(names_of(error), str(error))


def names_of(error: BaseException) -> list[str]:
    """Names of an error's classes, the nearest first."""
    return [kind.__name__ for kind in type(error).__mro__]


def named_problem(classes: list[str], message: str) -> Problem:
    """Return the answer to an error known by the names of its classes, the nearest first."""
    if classes[0] == DISK_FULL:
        log.error("the disk is full: %s", message)
        return Problem(507, FULL_TEXT, headers=RETRY)
    status, code = next((CODES[n] for n in classes if n in CODES), (422, STATUS_CODES[422]))
    return Problem(status, message, code)


def problem_for(error: Exception) -> Problem:
    """Return the answer to any error; the log has what it does not tell."""
    if isinstance(error, Problem):
        return error
    if is_disk_full(error):
        return named_problem([DISK_FULL], describe(error))
    if isinstance(error, UserError):
        return problem_of(error)
    if f"{type(error).__module__}.{type(error).__name__}" in AWAY:
        log.error("the database does not answer: %s", describe(error))
        return database_away()
    return internal_problem(error)


def database_away() -> Problem:
    """The answer while the database does not."""
    return Problem(503, "the database of jobs does not answer; try again", "database_away",
                   headers=RETRY)  # fmt: skip


def without_paths(text: str) -> str:
    """Return a text with every absolute path as its last part."""
    return _PATH.sub(lambda found: found[0].rstrip("/").rpartition("/")[2], text)


class InternalError(Exception):
    """An error in a worker that no user caused; the text is for the log."""


def internal_problem(error: BaseException) -> Problem:
    """Return the answer to an error of ours; the log has its class and the same number."""
    reference = secrets.token_hex(4)
    log.error("internal error %s: %s", reference, describe(error))
    return Problem(500, f"internal error {reference}; the service's log names it", "internal")


def describe(error: BaseException) -> str:
    """Class of an error and the last functions of ours that it passed, without text or paths."""
    if isinstance(error, InternalError):
        return one_line(error)
    steps, step = [], error.__traceback__
    while step is not None:
        name = step.tb_frame.f_globals.get("__name__", "")
        if name.partition(".")[0] in ("api", "deitalk", "rig"):
            steps.append(f"{name}.{step.tb_frame.f_code.co_name}:{step.tb_lineno}")
        step = step.tb_next
    number = errno.errorcode.get(getattr(error, "errno", None) or 0, "")
    return f"{type(error).__name__}{number and f' {number}'} in {' > '.join(steps[-3:])}"
