"""Names of processors, and whether this machine has them."""

import re

from deitalk.errors import DeitalkError

_NAME = re.compile(r"cpu|cuda(:\d{1,3})?|mps")


def check_device(name: str) -> str:
    """Return a device's name if it is one; imports no torch.

    Parameters
    ----------
    name : str
        ``cpu``, ``cuda`` (the first GPU), ``cuda:N`` (GPU number N, from 0) or ``mps`` (Apple).

    Raises
    ------
    DeitalkError
        If it is another name.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise DeitalkError(f"device {name!r} is unknown; use cpu, cuda, cuda:N (a number) or mps")
    return name


def require_device(name: str) -> str:
    """Return a device's name if this machine has it.

    Raises
    ------
    DeitalkError
        If the name is unknown (see `check_device`) or there is no such device.
    """
    import torch

    kind, _, number = check_device(name).partition(":")
    if kind == "cuda" and not int(number or 0) < torch.cuda.device_count():
        count = torch.cuda.device_count()
        raise DeitalkError(
            f"device {name!r}: torch finds {count or 'no'} CUDA device{'s' * (count != 1)} here; "
            f"use cpu{f' or cuda:0 to cuda:{count - 1}' if count else ''}"
        )
    if kind == "mps" and not torch.backends.mps.is_available():
        raise DeitalkError(f"device {name!r}: this machine has no Metal device; use cpu")
    return name
