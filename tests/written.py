"""Whether files are as deitalk wrote them."""

from pathlib import Path

from rig.files.manifest import is_changed, read_manifest


def changed_files(folder: Path) -> list[str]:
    """Files of the manifest that were changed since they were written; removed ones are not."""
    manifest = read_manifest(folder)
    files = {} if manifest is None else manifest.files
    return sorted(name for name, digest in files.items() if is_changed(folder / name, digest))
