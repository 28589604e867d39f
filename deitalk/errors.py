"""Errors a user can cause, one line each: the value, the rule, the way out.

::

    ValueError
    └── DeitalkError
        ├── AudioError       a recording that cannot be read or used
        ├── EmotionError     an unknown emotion, a malformed track or intensity
        ├── ConfigError      an unknown key or a value out of its range
        ├── CheckpointError  weights that do not fit
        ├── DataError        a dataset folder that does not hold what it must
        └── MissingError     a program or package this machine lacks
"""

from rig.errors import one_line


class DeitalkError(ValueError):
    """Something that the caller can correct; the message says how, in one line.

    Parameters
    ----------
    message : object
        The value, the rule and the way out.
    parameter : str
        Parameter that the message names in backticks as the way out (``set `force=True` ``);
        a command line names its option instead.
    """

    def __init__(self, message: object = "", *, parameter: str = "") -> None:
        super().__init__(one_line(message))
        self.parameter = parameter


class AudioError(DeitalkError):
    """A recording that cannot be read or used."""


class EmotionError(DeitalkError):
    """An unknown emotion, a malformed emotion track, or an intensity out of range."""


class ConfigError(DeitalkError):
    """An unknown configuration key, or a value out of its range."""


class CheckpointError(DeitalkError):
    """A checkpoint that is damaged or belongs to another model or control set."""


class DataError(DeitalkError):
    """A dataset folder that does not hold what it must."""


class MissingError(DeitalkError):
    """A program or package that this machine lacks; the message names the install line."""
