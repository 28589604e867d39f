"""Files and folders written completely or not at all, without loss of a user's own files.

::

    targets.py    one file: written beside, then renamed; which paths a command may write to; one
                  process at a time for each
    folder.py     a whole folder: staged, then exchanged file by file, with a journal; its manifest,
                  of the files that deitalk wrote, with hashes; single files of one that stays in
                  use, such as a training run's
"""

from rig.files.claims import cache_folder, claim
from rig.files.folder import check_folder, kind_of, output_folder, record, recover, remove_written
from rig.files.kept_folder import begin_folder, replace_recorded
from rig.files.targets import atomic_write, check_file, is_folder_name, remove_leftovers

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
