"""Requirements of a preview, checked before the work begins."""

from collections.abc import Iterable
from pathlib import Path

from deitalk.preview.mp4 import find_encoder
from deitalk.preview.page import check_player
from deitalk.preview.source import PreviewError

PAGES, VIDEOS = (".html", ".htm"), (".mp4",)


def check_needs(targets: Iterable[Path]) -> tuple[str, ...]:
    """Check that this installation can make every given file.

    Parameters
    ----------
    targets : paths
        ``.html`` and ``.mp4`` files to write.

    Returns
    -------
    tuple of str
        Notes for the user on the files to write.

    Raises
    ------
    PreviewError
        For another suffix.
    MissingError
        Without the built page, or without a video encoder.
    """
    notes = []
    for target in targets:
        suffix = target.suffix.lower()
        if suffix in PAGES:
            check_player()
        elif suffix in VIDEOS:
            notes.append(find_encoder().note)
        else:
            raise PreviewError(
                f"{target} has suffix {target.suffix or 'none'!r}; use .mp4 or .html"
            )
    return tuple(note for note in notes if note)
