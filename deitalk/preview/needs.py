"""Requirements of a preview, checked before the work begins."""

from collections.abc import Iterable
from pathlib import Path

from deitalk.preview.encoding import find_encoder
from deitalk.preview.page import check_player
from deitalk.preview.source import PreviewError
from rig.face.render.renderer import Backend, check_backend

PAGES, VIDEOS = (".html", ".htm"), (".mp4",)


def check_needs(targets: Iterable[Path], backend: Backend = "auto") -> tuple[str, ...]:
    """Check that this installation can make every given file.

    Parameters
    ----------
    targets : paths
        ``.html`` and ``.mp4`` files to write.
    backend : {'auto', 'opengl', 'software'}
        Renderer of a video.

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
    RigError
        If the backend is unknown, or is ``opengl`` and OpenGL is missing.
    """
    notes = []
    for target in targets:
        suffix = target.suffix.lower()
        if suffix in PAGES:
            check_player()
        elif suffix in VIDEOS:
            notes.append(find_encoder().note)
            check_backend(backend)
        else:
            raise PreviewError(
                f"{target} has suffix {target.suffix or 'none'!r}; use .mp4 or .html"
            )
    return tuple(note for note in notes if note)
