"""Files and folders on disk, written completely or not at all.

What is being written lies in a hidden entry next to its place (``.pinograsp-...``), with a lock file beside it as long
as its writer runs. An entry whose lock is free was left by a writer that was killed: the next one there removes it.
Every folder lists what was written into it (``files.txt``), and what is not listed is never removed.
"""

from pinograsp.writing.files import discard, list_in, place_of, safe_name, write_errors, write_file
from pinograsp.writing.folders import NewFolder, add_files, write_folder
from pinograsp.writing.locks import ASIDE, MOMENT, PATIENCE, InUse, left_over, lock, mark

__all__ = [
    "ASIDE",
    "MOMENT",
    "PATIENCE",
    "InUse",
    "NewFolder",
    "add_files",
    "discard",
    "left_over",
    "list_in",
    "lock",
    "mark",
    "place_of",
    "safe_name",
    "write_errors",
    "write_file",
    "write_folder",
]
