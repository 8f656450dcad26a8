"""Tests of windows and notebooks of two users that save to one named file: no saved step is lost."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import time
import warnings
from dataclasses import dataclass, field, replace

import pytest

import carina
from carina import commands as c
from carina.case import CaseFile, CaseFileError
from carina.errors import CarinaError, DiskError
from carina.phantom import write_phantom
from carina.render import Renderer
from carina.session import ErrorEvent, Session, UserMessage, case_files
from carina.session.store import named_file
from carina.session.store.named_file import free_path_beside
from carina.session.store.registry import CaseRecords
from user_folders import user_folders

NUM_ACTS = 24
FAULTS = ("locks", "no locks", "no hard links")


@pytest.fixture(scope="module")
def saved_case(tmp_path_factory):
    """Return the path of a CT with a case file beside it."""
    folder = tmp_path_factory.mktemp("named")
    write_phantom(carina.generate_phantom(spacing_mm=4.0, generations=3), folder / "scan")
    with carina.Case.open(folder / "scan" / "ct.nii.gz") as case:
        case.save(folder / "team.carina")
    return folder


@dataclass
class Author:
    """User with a home folder, a clock, and a list of the steps that Carina confirmed as saved."""

    name: str
    home: object
    clock_offset_s: float
    messages: list[str] = field(default_factory=list)
    saved: set[tuple[str, float]] = field(default_factory=set)
    refusals: int = 0
    """Number of saves that this user's window refused."""
    num_warnings: int = 0
    """Number of messages about refused saves that the user received."""

    def now_s(self):
        return time.time() + self.clock_offset_s

    def records(self):
        return CaseRecords(self.home / "cases", self.now_s)

    def hear(self, text):
        self.messages.append(text)


class Window(Author):
    """Workstation window of an author; the case is also stored in the user's own folder."""

    session = None

    def open(self, path):
        records = self.records()
        self.session = Session(
            lambda volume, transfer: Renderer(volume, transfer=transfer),
            records=records,
            files=replace(case_files(None, records), picture=None),
        )
        self.session.subscribe(
            lambda event: self.hear(event.message) if isinstance(event, UserMessage | ErrorEvent) else None
        )
        self.session.do(c.OpenPath(str(path)))
        self.session.jobs.wait_idle(None)
        if self.session.snapshot().case is None:
            self.end()

    @property
    def is_open(self):
        return self.session is not None

    def change(self):
        change(self.session)

    @property
    def keeper(self):
        return self.session._saving._saver

    def steps(self):
        return {(step.label, step.at_s) for step in self.session.snapshot().steps}

    def save(self, command):
        """Save the case. The user's live file stores every step at once; the named file may refuse the save."""
        before = len(self.messages)
        self.session.do(command)
        self.session.jobs.wait_idle(None)
        assert self.session._saving.write_now()
        self.saved |= self.steps()
        if self.keeper.info.copy_conflict is not None:
            self.refusals += 1
            self.num_warnings += any("carina" in text for text in self.messages[before:]) or bool(
                self.keeper.info.copy_problem
            )

    def tick(self):
        """Advance the clock by one minute, after which the named file is written again."""
        assert self.session._saving.write_now()
        self.saved |= self.steps()
        if self.keeper.named is not None and self.keeper._copy_is_behind():
            self.keeper._update_named_file()
            if self.keeper.info.copy_conflict is not None:
                self.refusals += 1
                self.num_warnings += bool(self.keeper.info.copy_problem)

    def close(self):
        assert self.session._saving.write_now()
        self.saved |= self.steps()
        before, keeper = len(self.messages), self.keeper
        was_behind = keeper.named is not None and keeper._copy_is_behind()
        self.end()
        if was_behind and keeper.info.copy_conflict is not None:
            self.refusals += 1
            self.num_warnings += any(text == keeper.info.copy_problem for text in self.messages[before:])

    def end(self):
        self.session.close()
        self.session = None


class Notebook(Author):
    """Program that uses :class:`carina.Case`; its case is stored only in the named file."""

    case = None

    @contextlib.contextmanager
    def at_home(self):
        before = dict(os.environ)
        os.environ.update(user_folders(self.home))
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            try:
                yield
            finally:
                self.messages += [str(one.message) for one in heard]
                os.environ.clear()
                os.environ.update(before)

    @property
    def is_open(self):
        return self.case is not None

    def open(self, path):
        with self.at_home(), contextlib.suppress(CaseFileError, carina.VolumeImportError):
            try:
                self.case = carina.Case.open(path)
            except DiskError as error:
                # Another program may have moved the file away; every other error fails the test.
                if error.code != "disk.missing" or "there is no such file" not in str(error):
                    raise

    def change(self):
        change(self.case._session)

    def steps(self):
        return {(step.label, step.at_s) for step in self.case.state.steps}

    def save(self, path=None, *, replace=False):
        with self.at_home():
            try:
                self.case.save(path, replace=replace)
                self.saved |= self.steps()
            except CarinaError as refused:
                self.refusals += 1
                self.num_warnings += refused.code in {"case.changed", "case.read-only", "case.exists"}
                self.hear(str(refused))

    def close(self):
        steps, has_note = self.steps(), self.case.note is not None
        with self.at_home():
            try:
                self.case.close()
            except CarinaError as refused:
                self.refusals += 1
                self.num_warnings += "are saved in" in str(refused) or refused.code == "case.not-saved"
                self.hear(str(refused))
        if not has_note:
            self.saved |= steps
        self.case = None

    end = close


def change(session):
    """Change the outline in a step whose time differs from the times of other users' steps."""
    outline = session.snapshot().document.look.outline
    session.do(c.SetOutline("round" if outline == "octagon" else "octagon"))


def steps_in(path):
    try:
        with CaseFile.open(path, read_only=True) as case:
            return {(step.label, step.at_s) for step in case.history()}
    except CarinaError:
        return set()


class Ward:
    """Two windows and two notebooks of two users, with their case files in one folder."""

    def __init__(self, folder, saved_case, rng):
        self.rng, self.path = rng, folder / "work" / "team.carina"
        shutil.copytree(saved_case, folder / "work")
        # The clock of the second user is two years behind.
        self.authors = [
            cls(name, folder / name.replace(" ", "-"), offset_s)
            for cls, name, offset_s in (
                (Window, "A", 0.0),
                (Window, "B", -2 * 365 * 86400.0),
                (Notebook, "A notebook", 0.0),
                (Notebook, "B notebook", 0.0),
            )
        ]
        self.count = 0
        self.foreign: set[bytes] = set()

    def act(self):
        author = self.rng.choice(self.authors)
        if not author.is_open:
            paths = sorted(self.path.parent.glob("*.carina"))
            author.open(self.rng.choice([self.path, *paths]))
            return
        act = self.rng.choice(
            ["change", "change", "change", "save", "save", "replace", "beside", "tick", "close", "disturb"]
        )
        path = self.path
        if act == "change":
            author.change()
        elif act == "close":
            author.close()
        elif act == "disturb":
            self.disturb()
        elif isinstance(author, Window):
            if act == "tick" or author.keeper.copy_path is None:
                author.tick()
            elif act == "save":
                author.save(c.SaveCase())
            elif act == "replace":
                author.save(c.SaveCase(str(path), replace=True))
            else:
                author.save(c.SaveCase(str(free_path_beside(path))))
        elif act == "replace":
            author.save(path, replace=True)
        elif act == "beside":
            author.save(free_path_beside(path))
        else:
            author.save()

    def disturb(self):
        """Change the file as other programs and network shares do: move it, set old times, or overwrite it."""
        what = self.rng.choice(["touch", "copy back", "letter", "move"])
        if not self.path.exists():
            return
        if what == "touch":
            os.utime(self.path, (1e9, 1e9))
        elif what == "copy back":
            self.count += 1
            copy = self.path.with_name(f"copy {self.count}.carina")
            shutil.copy2(self.path, copy)
        elif what == "letter":
            self.count += 1
            moved_path = self.path.with_name(f"moved {self.count}.carina")
            self.path.rename(moved_path)
            text = f"letter {self.count}".encode()
            self.path.write_bytes(text)
            self.foreign.add(text)
        else:
            self.count += 1
            self.path.rename(self.path.with_name(f"moved {self.count}.carina"))

    def check(self):
        for author in self.authors:
            if author.is_open:
                author.close()
        files = sorted(self.path.parent.glob("*.carina"))
        in_files = set().union(*(steps_in(path) for path in files))
        contents = {path.read_bytes() for path in files}
        assert self.foreign <= contents, "a file of the user was overwritten"
        for author in self.authors:
            places = set(in_files)
            if isinstance(author, Window):
                records = author.records()
                places = places.union(*(steps_in(records.path_of(one)) for one in records.all()))
            assert author.saved <= places, (
                f"{author.name} has lost {len(author.saved - places)} steps: {author.messages}"
            )
            assert author.num_warnings == author.refusals, f"{author.name} got no warning: {author.messages}"
        assert not list(self.path.parent.glob("*being replaced*"))
        assert not list(self.path.parent.glob(".*.draft"))


def interleave(saved_case, folder, monkeypatch, seed):
    rng = random.Random(seed)
    fault = FAULTS[seed % len(FAULTS)]
    with monkeypatch.context() as patches:
        if fault == "no locks":
            patches.setattr(named_file.NamedLock, "take", staticmethod(lambda _path: None))
        if fault == "no hard links":

            def link(_source, _target):
                raise OSError(1, "Operation not permitted")

            patches.setattr(os, "link", link)
        ward = Ward(folder, saved_case, rng)
        try:
            for _ in range(NUM_ACTS):
                ward.act()
            ward.check()
        finally:
            for author in ward.authors:
                if author.is_open:
                    author.end()
    return ward


# Three orders for each fault; `make soak` draws a thousand.
@pytest.mark.parametrize("seed", range(9))
def test_random_order_of_saves_by_two_programs_loses_no_saved_change(saved_case, tmp_path, monkeypatch, seed):
    interleave(saved_case, tmp_path, monkeypatch, seed)


@pytest.mark.soak
def test_a_thousand_random_orders_of_saves_by_two_programs_lose_no_saved_change(saved_case, tmp_path, monkeypatch):
    refusals = 0
    for seed in range(1000, 2000):
        folder = tmp_path / str(seed)
        ward = interleave(saved_case, folder, monkeypatch, seed)
        refusals += sum(author.refusals for author in ward.authors)
        shutil.rmtree(folder)
    print(f"1,000 interleavings: {refusals} saves refused, each with a message")
