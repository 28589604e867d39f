"""Numbers as people write them: ``0.5``, ``0,5``, ``50%``."""

import math
from typing import Any


def number_of(value: Any, *, percent: bool = True) -> float:
    """A number, or its text with a decimal point or comma; NaN where it is none.

    Parameters
    ----------
    value : object
        A number or a text; a truth value is no number.
    percent : bool
        Whether a text may end with ``%``: ``50%`` is 0.5. Not for seconds, degrees and the like.
    """
    if isinstance(value, bool):
        return math.nan
    try:
        if not isinstance(value, str):
            return float(value)
        text = value.strip().replace(",", ".")
        is_percent = percent and text.endswith("%")
        return float(text[:-1]) / 100 if is_percent else float(text)
    except (TypeError, ValueError, OverflowError):
        return math.nan
