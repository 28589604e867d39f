"""Warnings about the curves of a line, beside those of its recording."""

from deitalk.pipeline.performance import Performance


def findings(performance: Performance) -> tuple[str, ...]:
    """Warnings about a performance that a person should look at."""
    return ()
