"""Answers in JSON."""

from datetime import UTC, datetime
from typing import Any, Literal

from pydantic import BaseModel, Field

from api.jobs.table import DONE, Job

JOB_EXAMPLE = "q0Vn3cG5a3hJQk1x8o0y2C7m6r1S4t9uW-Ezb5dLfPI"


class ProblemView(BaseModel):
    """Every error."""

    code: str = Field(examples=["emotion_invalid"])
    message: str = Field(
        examples=["unknown emotion 'hapy'; known are neutral, angry, happy, sad, surprised"]
    )
    detail: Any = Field(default=None, examples=[None])


class ModelView(BaseModel):
    """A model that requests may name."""

    name: str = Field(examples=["default"])
    product: Literal["curves", "mesh"]
    control_set: str | None = Field(examples=["metahuman-185@mh4"])
    is_default: bool


class FormatView(BaseModel):
    """A kind of result."""

    name: str
    suffix: str
    media_type: str
    description: str


class EmotionsView(BaseModel):
    """Emotions, and the range of their intensity."""

    emotions: list[str]
    procedural: list[str]
    """Emotions that no capture taught the network."""
    variants: dict[str, list[str]]
    """Names of the ways to show each."""
    intensity_minimum: float
    intensity_maximum: float


class ControlSetView(BaseModel):
    """A control set."""

    id: str = Field(examples=["metahuman-185@mh4"])
    controls: int


class ControlView(BaseModel):
    """A control."""

    name: str = Field(examples=["CTRL_C_jaw.ty"])
    minimum: float
    maximum: float
    rest: float


class FindingView(BaseModel):
    """A finding of a check."""

    level: Literal["error", "warning", "note"]
    text: str


class ValidationView(BaseModel):
    """Findings about a file of curves."""

    ok: bool
    findings: list[FindingView]


class StatusView(BaseModel):
    """State of the service."""

    status: str = Field(examples=["ok"])
    version: str


class JobView(BaseModel):
    """A job."""

    id: str = Field(examples=[JOB_EXAMPLE])
    kind: str = Field(examples=["animation"])
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    progress: float = Field(ge=0, le=1)
    created: datetime
    started: datetime | None
    finished: datetime | None
    format: str
    result: str | None = Field(description="Path of the result", examples=[None])
    result_bytes: int
    notes: list[str]
    facts: dict[str, Any]
    error: ProblemView | None


class JobsView(BaseModel):
    """Jobs, the newest first."""

    jobs: list[JobView]


def view_of(job: Job) -> JobView:
    """Return what a caller may see of a job."""
    answer = job.answer or {}
    return JobView(
        id=job.id,
        kind=job.work["order"]["kind"],
        status=job.status,  # type: ignore[arg-type]
        progress=job.progress,
        created=_time(job.created),
        started=None if job.started is None else _time(job.started),
        finished=None if job.finished is None else _time(job.finished),
        format=job.work["format"],
        result=f"/v1/jobs/{job.id}/result" if job.status == DONE else None,
        result_bytes=job.result_bytes,
        notes=answer.get("notes", []),
        facts=answer.get("facts", {}),
        error=None if job.error is None else ProblemView(**job.error),
    )


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
