"""Errors a user can cause, one line each: the value, the rule, the way out.

::

    ValueError
    └── UserError                anything the caller can correct (rig.errors)
        └── DeitalkError
            ├── AudioError       a recording that cannot be read or used
            ├── EmotionError     an unknown emotion, a malformed track or intensity
            ├── ConfigError      an unknown key or a value out of its range
            ├── CheckpointError  weights that do not fit
            ├── DataError        an incomplete dataset folder
            └── MissingError     a program or package this machine lacks
"""

from rig.errors import UserError


class DeitalkError(UserError):
    """An error about speech, emotions, models or data."""


class AudioError(DeitalkError):
    """A recording that cannot be read or used."""


class EmotionError(DeitalkError):
    """An unknown emotion, a malformed emotion track, or an intensity out of range."""


class ConfigError(DeitalkError):
    """An unknown configuration key, or a value out of its range."""


class CheckpointError(DeitalkError):
    """A checkpoint that is damaged or belongs to another model or control set."""


class DataError(DeitalkError):
    """A dataset folder that lacks files or columns, or holds wrong ones."""


class MissingError(DeitalkError):
    """A program or package that this machine lacks; the message names the install line."""
