"""Files and folders written completely or not at all, without loss of a user's own files.

::

    targets.py    one file: written beside, then renamed; which paths a command may write to
    claims.py     one process at a time for each target
    folder.py     a whole folder, or one file of a folder that stays in use: staged, then exchanged
                  file by file, with a journal; its manifest, of the files that deitalk wrote, with
                  hashes
    reading.py    files of others, read within limits
"""

from rig.files.atomic import atomic_write, remove_leftovers
from rig.files.claims import cache_folder, claim
from rig.files.folder import (
    begin_folder,
    check_folder,
    output_folder,
    recover,
    remove_written,
    replace_recorded,
)
from rig.files.manifest import kind_of, record
from rig.files.targets import check_file, is_folder_name

__all__ = [
    "atomic_write",
    "begin_folder",
    "cache_folder",
    "check_file",
    "check_folder",
    "claim",
    "is_folder_name",
    "kind_of",
    "output_folder",
    "record",
    "recover",
    "remove_leftovers",
    "remove_written",
    "replace_recorded",
]
