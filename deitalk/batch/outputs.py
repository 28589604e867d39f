"""Files of a batch in its output folder, none of the user's replaced; the journal of them."""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from deitalk.batch.journal import DONE, FAILED, PLACING, Entry, Journal
from deitalk.batch.orders import File, Outcome
from deitalk.pipeline.performance import KIND as TAKE_KIND
from rig import limits
from rig.errors import TargetError
from rig.files import (
    atomic_write,
    begin_folder,
    check_folder,
    claim,
    output_folder,
    recover,
    replace_recorded,
)
from rig.files.manifest import MANIFEST, digest_of
from rig.files.reading import read_bytes

KIND = "batch"
"""Kind of the output folder in its manifest."""
PRIVATE = ".deitalk-batch"
"""Folder of the journal and of unfinished files."""
STAGE = f"{PRIVATE}/stage"


class Outputs:
    """Results of lines below one folder.

    Parameters
    ----------
    folder : Path
        The output folder.
    journal : Journal
        Of that folder.
    shown : str
        Its name in messages.
    """

    def __init__(self, folder: Path, journal: Journal, shown: str) -> None:
        self.folder, self.journal, self.shown = folder, journal, shown
        self.stage = str(folder / STAGE)

    def begin(self) -> None:
        """Finish what a killed process placed, or leave it to be made again."""
        shutil.rmtree(self.stage, ignore_errors=True)
        os.makedirs(self.stage)
        for entry in self.journal.entries(PLACING):
            recover(self.folder / entry.output)
            new = self.journal.files(entry.output, new=True)
            if new and all(self._state(file) == "intact" for file in new):
                self._finish([entry])

    def state(self, output: str) -> str:
        """Whether the files of a finished line are ``intact``, ``missing`` or ``edited``."""
        states = {self._state(file) for file in self.journal.files(output, new=False)}
        return next((s for s in ("missing", "edited") if s in states), "intact")

    def check_free(self, targets: Sequence[str]) -> None:
        """Refuse targets where files lie that the batch did not write.

        Raises
        ------
        TargetError
            If there is one, or one was changed since it was written.
        """
        for target in targets:
            path = self.folder / target
            if not os.path.lexists(path):
                above = next((parent for parent in path.parents if parent.exists()), path)
                if not above.is_dir():
                    raise TargetError(f"{above} is a file; name another output")
            elif path.is_dir() and not path.is_symlink() and not path.suffix:
                # A folder may be filled if its take is unchanged, or it holds nothing.
                recover(path)
                check_folder(path, kind=TAKE_KIND, force=True)
                if any(path.iterdir()) and not self._is_own(f"{target}/take.json"):
                    raise TargetError(
                        f"{self.shown}/{target} is a take that this batch did not write; move it "
                        "away, or name another output"
                    )
            elif not self._is_own(target):
                raise TargetError(
                    f"{self.shown}/{target} was not written by this batch, or was changed since; "
                    "move it away, or name another output"
                )

    def place(self, results: Sequence[tuple[Entry, Outcome]]) -> None:
        """Give staged files their names and enter the results, all in two transactions."""
        good = []
        with self.journal.transaction():
            for entry, outcome in results:
                if outcome.files:
                    entry.state = PLACING
                    self.journal.announce(entry.output, outcome.files)
                    good.append((entry, outcome))
                self.journal.write(entry)
        placed = []
        for entry, outcome in good:
            try:
                self._move(Path(outcome.stage), outcome)
            except TargetError as error:  # the user changed it meanwhile
                entry.state, entry.error = FAILED, str(error)
                with self.journal.transaction():
                    self.journal.write(entry)
            else:
                placed.append(entry)
        self._finish(placed)

    def reference(self, name: str) -> bytes | None:
        """Content of a reference of an actor."""
        path = self.folder / name
        return read_bytes(path, limits.TRACK_JSON_BYTES) if path.is_file() else None

    def keep_reference(self, name: str, text: str) -> None:
        """Write a reference of an actor."""
        (self.folder / name).parent.mkdir(exist_ok=True)
        with atomic_write(self.folder / name) as beside:
            beside.write_text(text, encoding="utf-8")

    def has_table(self, name: str) -> bool:
        """Whether a table is there."""
        return (self.folder / name).is_file()

    def write_table(self, name: str, text: str) -> None:
        """Write a table.

        Raises
        ------
        TargetError
            If the user changed it.
        """
        replace_recorded(self.folder, name, text)

    def _finish(self, entries: Sequence[Entry]) -> None:
        """Remove what lines no longer write, and enter them as done."""
        for entry in entries:
            new = {file.path for file in self.journal.files(entry.output, new=True)}
            for file in self.journal.files(entry.output, new=False):
                if file.path not in new and self._state(file) == "intact":
                    (self.folder / file.path).unlink(missing_ok=True)
                    with suppress(OSError):
                        (self.folder / file.path).parent.rmdir()
        with self.journal.transaction():
            for entry in entries:
                self.journal.settle(entry.output)
                entry.state = DONE
                self.journal.write(entry)

    def _move(self, stage: Path, outcome: Outcome) -> None:
        for target in outcome.targets:
            source, path = stage / target.name, self.folder / target.path
            self.check_free([target.path])
            path.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir() and path.is_dir():  # others than the take's files stay in it
                with output_folder(path, kind=TAKE_KIND, force=True) as beside:
                    for name in os.listdir(source):
                        if name != MANIFEST:
                            os.replace(source / name, beside / name)
            else:
                os.replace(source, path)
        shutil.rmtree(stage, ignore_errors=True)

    def _state(self, file: File) -> str:
        """Whether a file is as it was written."""
        path = self.folder / file.path
        try:
            found = path.lstat()
        except OSError:
            return "missing"
        if found.st_size == file.size and found.st_mtime_ns == file.mtime:
            return "intact"
        is_same = found.st_size == file.size and path.is_file() and digest_of(path) == file.sha
        return "intact" if is_same else "edited"

    def _is_own(self, target: str) -> bool:
        return any(self._state(file) == "intact" for file in self.journal.hashes(target))


@contextmanager
def opened_folder(out: Path, shown: str = "") -> Iterator[Outputs]:
    """The outputs in a folder that no other process writes to; messages call it `shown`.

    Raises
    ------
    TargetError
        If another process writes there, the folder holds files of others, or a table was edited.
    """
    with claim(out):
        begin_folder(out, kind=KIND)
        (out / PRIVATE).mkdir(exist_ok=True)
        with closing(Journal(out / PRIVATE / "journal.sqlite", shown or out)) as journal:
            outputs = Outputs(out, journal, shown or str(out))
            yield outputs
            shutil.rmtree(outputs.stage, ignore_errors=True)
