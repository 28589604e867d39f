"""What commands ask of the files they are given and of those they are to write."""

from pathlib import Path

from deitalk.errors import DeitalkError

PICTURES = (".png", ".svg", ".pdf")


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise before the work begins where a file would be replaced unasked."""
    if path.exists() and not force:
        raise DeitalkError(f"{path} exists; add --force to replace it, or name another file")


def check_picture(path: Path, *, force: bool) -> None:
    """Raise where `path` is no picture that matplotlib writes, or is there already."""
    if path.suffix not in PICTURES:
        raise DeitalkError(f"{path}: a picture is .png, .svg or .pdf")
    refuse_existing(path, force=force)


def curves_of(source: Path) -> Path:
    """Find the file of curves of a take folder; a file stands for itself."""
    if not source.is_dir():
        return source
    for name in ("curves.json", "curves.npz", "curves.csv"):
        if (source / name).is_file():
            return source / name
    raise DeitalkError(f"{source} holds no curves; give a take folder or a file of curves")


def identity_of(text: str) -> int | str:
    """Read the number or the name of an embedded head."""
    return int(text) if text.lstrip("-").isdigit() else text
