"""Workstation for tests that stores its cases in memory and can be started, killed and started again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from carina import commands as c
from carina.errors import CarinaError
from carina.session import Session
from carina.session.saving.autosave import CaseFileFunctions
from carina.session.store.registry import CaseRecords
from small_case import Background, Clock, SmallRenderer, small_parts

WAIT_S = 60.0


class Wall:
    """Clock with the time of day, in seconds since 1970, that a test sets."""

    def __init__(self) -> None:
        self.now_s = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now_s


def put_text(path: Path, text: str, placement: Any) -> None:
    """Write a text to a draft and move the draft to its path, as a case file does."""
    draft = path.with_name(path.name + ".draft")
    draft.write_text(text)
    (placement or Path.replace)(draft, path)


class MemoryFile:
    """Case file that is stored in memory under its path."""

    contents: dict[str, tuple[str, Any]] = {}  # noqa: RUF012 - one disk

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest
        self.num_saved = 0
        self.refuses: OSError | None = None

    def save(self, moment: Any) -> None:
        if self.refuses is not None:
            raise self.refuses
        self.num_saved += 1
        self.contents[str(self.path)] = (self.digest, moment)
        self.path.write_text("kept")

    def load(self, volume: Any) -> Any:
        moment = self.contents[str(self.path)][1]
        if moment is None:
            raise CarinaError("the file is damaged", code="case.damaged")
        return moment

    def keep_recording(self, recording: Any) -> None:
        if self.refuses is not None:
            raise self.refuses

    def recordings(self) -> Any:
        return ()

    def set_recordings(self, wanted: Any, *, removed: Any) -> None:
        if self.refuses is not None:
            raise self.refuses

    def recording_text(self, recording_id: int) -> str:
        raise CarinaError("the file is damaged", code="case.damaged")

    def write_copy(
        self, path: Path, *, ct_place: str | None = None, save_mark: Any = None, placement: Any = None
    ) -> None:
        if self.refuses is not None:
            raise self.refuses
        put_text(path, f"copy of {self.digest}, {ct_place}, {save_mark}", placement)

    def close(self) -> None:
        self.closed = True


class RestartableWorkstation:
    """Workstation that is started, killed and started again with the same stored cases."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.wall = folder, Wall()
        self.digest = "one CT"
        self.files: list[MemoryFile] = []
        self.written: dict[str, Any] = {}
        """Contents of cases that were written as whole files without a live file, by path."""
        self.store: Any = None

    def start(self) -> Session:
        self.background, self.clock = Background(), Clock()
        self.events: list[Any] = []

        def create(path: Path, volume: Any, digest: str) -> MemoryFile:
            self.files.append(MemoryFile(path, digest))
            return self.files[-1]

        def reopen(path: Path) -> MemoryFile:
            return create(path, None, MemoryFile.contents[str(path)][0])

        def write(path: Path, case: Any, ct_place: str | None, save_mark: Any, placement: Any) -> None:
            put_text(path, f"{case.digest} whole, {ct_place}, {save_mark}", placement)
            self.written[str(path)] = case.moment

        self.session = Session(
            SmallRenderer,
            parts=small_parts(),
            submit=self.background,
            clock=self.clock,
            records=CaseRecords(self.folder / "cases", self.wall),
            files=self.file_functions(CaseFileFunctions(create, reopen, write, lambda _volume: self.digest)),
            store=self.store,
        )
        self.session.subscribe(self.events.append)
        return self.session

    def file_functions(self, files: CaseFileFunctions) -> CaseFileFunctions:
        """Return the functions that open case files; subclasses replace them."""
        return files

    def open(self, path: str = "case") -> None:
        self.session.do(c.OpenPath(path))
        self.background.run_all()

    def saved(self) -> None:
        assert self.session._saving.write_now()

    def kill(self) -> None:
        """Simulate a kill: nothing more is written, and the locks are released as by the operating system.

        A write that is in progress is completed.
        """
        saver = self.session._saving._saver
        assert saver is not None
        self.session._saving._saver = None
        with saver._wake:
            saver._wake.notify_all()
            assert saver._wake.wait_for(lambda: saver.has_ended, WAIT_S)
        if saver._copier is not None:
            saver._copier.join(WAIT_S)
            assert not saver._copier.is_alive()
        if saver.held is not None:
            saver.held.release()
        if saver._claim is not None:
            saver._claim.release()
        if saver.named is not None:
            saver.named.close()
