"""A case that a running Carina has open, as a program uses it: the owner runs commands and reports changes.

The owner stores the case; this process reads the stored case, read only, in a separate session that follows the owner.
After the owner has ended, the first follower that takes the case's lock becomes the owner and continues the case.
"""

from __future__ import annotations

import threading
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

from carina import commands as c
from carina.case import CaseFile, CaseFollower, Moment
from carina.commands.value import LocalCommand, checked
from carina.config import load_settings
from carina.errors import CarinaError, UsageError
from carina.render import Sight
from carina.session.attach.client import LinkLostError, OwnerConnection
from carina.session.attach.messages import Settled
from carina.session.attach.select import do_and_wait, program_session
from carina.session.attach.working_copy import NamedCase
from carina.session.engines import default_parts
from carina.session.saving.unsaved_work import named_file_messages
from carina.session.session import Session
from carina.session.state.snapshot import SavingInfo
from carina.session.store.attach_endpoint import AttachEndpoint
from carina.session.store.disk_storage import case_files
from carina.session.store.find_scan import CASE_SUFFIX, CaseScans, is_case_file
from carina.session.store.registry import CaseRecord, CaseRecords
from carina.volume import VolumeCache

OWNED_WITHIN_S = 20.0
"""Maximum time in s to take over a case whose former owner still writes the last changes."""
DOOR_WITHIN_S = 3.0
POLL_INTERVAL_S = 0.05
CLOCKS_S = 0.1
"""Tolerance in s in the comparison of a step's time (since its case was created) with a clock time."""
OTHER_CASES = (
    c.OpenPath,
    c.OpenSeries,
    c.OpenDemo,
    c.OpenRecent,
    c.OpenFiles,
    c.OpenVolume,
    c.BeginAnew,
    c.CloseCase,
)
"""Commands that are refused because they would close this case in the window."""


@dataclass(slots=True)
class _FollowedCase:
    """The follower of the owner's live file, and the state of the case that the session shows."""

    follower: CaseFollower
    moment: Moment


class RemoteCase:
    """Case that another process owns and stores; :meth:`join` creates one.

    Parameters
    ----------
    records
        Records of the user's cases.
    case_id
        ID of the case.
    session
        Session of this process that mirrors the case.
    link
        Connection to the owner.
    followed
        Follower of the live file, and the state of the case that the session shows.
    """

    def __init__(
        self, records: CaseRecords, case_id: str, session: Session, link: OwnerConnection, followed: _FollowedCase
    ) -> None:
        self._records = records
        self._case_id = case_id
        self._session = session
        self._link: OwnerConnection | None = link
        self._followed = followed
        self._saving = SavingInfo()
        self._named: NamedCase | None = None
        """Named file for this program's changes if the owner has ended and this process could not become the owner."""
        self._pending_warning: str | None = None
        """Message that is shown to the user once, at the next call."""
        self._lock = threading.RLock()
        self._closed = False

    # ------------------------------------------------------------ joining

    @classmethod
    def join(cls, source: str | Path, ct: str | Path | None) -> RemoteCase | None:
        """Join the case of a file or a CT that a running Carina of this user has open.

        Parameters
        ----------
        source
            A case file, or the path of a CT.
        ct
            Path of the CT of a case file, if the CT has moved.

        Returns
        -------
        RemoteCase or None
            None if no running Carina has the case open.

        Raises
        ------
        CaseFileError
            ``case.no-scan``: if the CT of the case is not found.
        """
        settings = load_settings()
        records = CaseRecords(settings.cases_dir, time.time)
        for record in _candidate_records(records, source):
            link = _connect_to_owner(records, record)
            if link is None:
                continue
            try:
                joined = cls._joined(records, record, link, ct)
            except LinkLostError:
                link.close()
                continue
            except BaseException:
                link.close()
                raise
            link.watch(joined._on_connection_lost)
            return joined
        return None

    @classmethod
    def _joined(
        cls, records: CaseRecords, record: CaseRecord, link: OwnerConnection, ct: str | Path | None
    ) -> RemoteCase:
        settings = load_settings()
        # The owner replies after its running jobs, such as the airway search, have ended.
        saving = _checked_saving_info(link.settle(all_jobs=True))
        cache = VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)
        scans = CaseScans(cache, records, default_parts().open_demo, advice="give its location as ct=PATH")
        path = records.path_of(record)
        with CaseFile.open(path, read_only=True) as file:
            volume = scans.open(file, ct=ct).volume
        follower = CaseFollower(path, volume)
        moment = follower.latest_moment()
        session = program_session(records=records, files=case_files(cache, records))
        try:
            do_and_wait(session, c.OpenVolume(volume, moment, follows=True))
        except BaseException:
            session.close()
            raise
        joined = cls(records, record.case_id, session, link, _FollowedCase(follower, moment))
        joined._saving = saving
        return joined

    # ------------------------------------------------------------ interface of ProgramCase

    @property
    def session(self) -> Session:
        """The session with all changes to the case so far, by this program and by others."""
        with self._lock:
            self._wait_for_owner()
            self._issue_warning()
            return self._session

    @property
    def path(self) -> Path | None:
        """Path of the named file, which this program or another may have chosen; None without one."""
        session = self.session
        if self._named is not None:
            return self._named.path
        return _named_file_path(session.snapshot().saving if self._link is None else self._saving)

    @property
    def note(self) -> str | None:
        """Reason why the case is no longer stored; None while a process stores it."""
        with self._lock:
            return None if self._named is None else self._named.note

    def do(self, command: c.Command) -> None:
        """Run a command in the owner's process; a command that changes only the sight runs in this process."""
        if isinstance(command, OTHER_CASES):
            raise UsageError(
                f"{type(command).__name__} would close this case in the window; open the other case with "
                "carina.Case.open",
                code="case.joined",
            )
        if _is_sight(command):
            do_and_wait(self.session, command)
            return
        if not isinstance(command, LocalCommand):
            command = checked(command)
        with self._lock:
            while (link := self._link) is not None:
                if isinstance(command, LocalCommand):
                    raise UsageError(
                        f"{type(command).__name__} cannot be sent to the Carina window that has this case open; do it "
                        "there, or close the case there first",
                        code="case.joined",
                    )
                if isinstance(command, c.Undo | c.Redo):
                    self._wait_for_owner()
                sent_s, position = self._records.now_s(), self._followed.moment.position
                try:
                    self._saving = link.do(command).saving
                    break
                except LinkLostError:
                    self._continue_without_owner(link)
                    if self._is_command_stored(command, sent_s, position):
                        break
            else:
                do_and_wait(self._session, command)
        if isinstance(command, c.ShowPlace):
            do_and_wait(self.session, c.SetCrosshair(command.lps))
        self._issue_warning()

    def save(self, path: str | Path | None, *, replace: bool) -> Path:
        """Let the owner write the case to a file, which the owner updates from then on."""
        if self._named is not None:
            if path is None and self._named.note is not None:
                raise UsageError(self._named.note, code="case.read-only")
            state = self._session.snapshot()
            assert state.case is not None
            return self._named.save(state.case.volume, self._session.ask(c.CurrentMoment()), path, replace=replace)
        if path is not None:
            target = Path(path).expanduser().absolute()
            if target.suffix.lower() != CASE_SUFFIX:
                target = target.with_name(target.name + CASE_SUFFIX)
            if not target.parent.is_dir():
                raise UsageError(f"the folder {target.parent} does not exist", code="case.no-place")
            self.do(c.SaveCase(str(target), replace))
            return target
        self.do(c.SaveCase())
        found = self.path
        assert found is not None
        return found

    def close(self) -> None:
        """Disconnect from the owner; as the owner, write the remaining changes.

        Raises
        ------
        UnsavedWorkError
            If the owner has ended, this program could not take over the case, and later changes are in no file.
        CarinaError
            ``case.not-saved`` if this program is the owner and the disk refuses the latest changes.
        """
        with self._lock:
            self._closed = True
            link, self._link = self._link, None
        try:
            if link is not None:
                link.close()
            elif self._named is None:
                self._session.do(c.KeepNow())
            else:
                live = self._records.live_path(self._case_id)
                moment = self._session.ask(c.CurrentMoment())
                self._named.check_saved(moment, last_saved=self._followed.moment, live=live)
        finally:
            self._close_session()
            if self._named is not None:
                self._named.close()

    def _close_session(self) -> None:
        """Close the session, and warn of a named file that does not have the latest changes."""
        with named_file_messages(self._session.subscribe) as messages:
            self._session.close()
        for message in messages:
            warnings.warn(message, stacklevel=4)

    # ------------------------------------------------------------ following the state of the owner

    def _wait_for_owner(self) -> None:
        """Wait for the owner's changes so far and show them in the session; the caller holds this object's lock."""
        while (link := self._link) is not None:
            try:
                self._saving = _checked_saving_info(link.settle())
                self._show_latest_state()
            except LinkLostError:
                self._continue_without_owner(link)
            else:
                return

    def _show_latest_state(self) -> None:
        """Show the newest state of the case in the live file; the caller holds the lock."""
        moment = self._followed.follower.latest_moment()
        if moment is not self._followed.moment:
            do_and_wait(self._session, c.FollowMoment(moment))
            self._followed.moment = moment

    def _issue_warning(self) -> None:
        """Issue the pending message to the user as a Python warning, and delete the message."""
        words, self._pending_warning = self._pending_warning, None
        if words is not None:
            warnings.warn(words, stacklevel=4)

    # ------------------------------------------------------------ actions after the owner has ended

    def _on_connection_lost(self, link: OwnerConnection) -> None:
        """Start a thread that takes over the case after the connection to its owner has ended."""
        with self._lock:
            if not self._closed:
                self._continue_without_owner(link)

    def _continue_without_owner(self, link: OwnerConnection) -> None:
        """Take over the case, or join its new owner; if neither is possible, work on a named file.

        The caller holds this object's lock.
        """
        if self._link is not link:
            return
        link.close()
        self._link = None
        end_s = time.monotonic() + OWNED_WITHIN_S
        while True:
            try:
                self._session.do(c.TakeOver(self._case_id))
                self._session.jobs.wait_idle(None)
                self._pending_warning = (
                    "the program that had this case open has ended or closed it; this program has taken over and "
                    "continues to save the case"
                )
                return
            except (CarinaError, OSError) as error:
                if getattr(error, "code", "") != "case.open":
                    self._become_sole_process(str(error))
                    return
            record = self._records.find(self._case_id)
            endpoint = None if record is None else self._records.endpoint_of(record)
            if endpoint is not None and self._join_new_owner(endpoint):
                self._pending_warning = (
                    "the program that had this case open has ended or closed it; another program has opened it, and "
                    "this program has joined that one"
                )
                return
            if (endpoint is not None and endpoint.url is None) or time.monotonic() >= end_s:
                self._become_sole_process("another program has it open")
                return
            time.sleep(POLL_INTERVAL_S)

    def _join_new_owner(self, endpoint: AttachEndpoint) -> bool:
        link = OwnerConnection.connect(endpoint, self._case_id)
        if link is None:
            return False
        try:
            self._saving = _checked_saving_info(link.settle())
            self._show_latest_state()
        except LinkLostError:
            link.close()
            return False
        self._link = link
        link.watch(self._on_connection_lost)
        return True

    def _become_sole_process(self, why: str) -> None:
        self._named = NamedCase()
        self._named.path = _named_file_path(self._saving)
        self._named.note = self._pending_warning = (
            f"the program that had this case open has ended or closed it, and this one cannot take over: {why}. "
            "Changes made here can be saved under another name"
        )

    def _is_command_stored(self, command: c.Command, sent_s: float, position: int) -> bool:
        """Return whether a command without confirmation is a step of the case that the former owner has stored."""
        moment = self._session.ask(c.CurrentMoment())
        if isinstance(command, c.Undo | c.Redo):
            return bool(moment.position != position)
        begun_s = self._saving.begun_s
        return begun_s is not None and any(
            step.command == command and begun_s + step.at_s >= sent_s - CLOCKS_S for step in moment.steps
        )


def _candidate_records(records: CaseRecords, source: str | Path) -> list[CaseRecord]:
    """Return the records of the cases to which a case file or a CT may belong, the case used last first."""
    place = str(Path(source).expanduser().absolute())
    if is_case_file(place):
        return [one for one in records.all() if place in {one.copy_path, str(records.path_of(one))}]
    return [one for one in records.all() if one.place == place]


def _connect_to_owner(records: CaseRecords, record: CaseRecord) -> OwnerConnection | None:
    """Return a connection to the process that has a case open; None if the program cannot join a process.

    The owner writes its connection details once the case is on the disk, which takes a moment after the opening.
    """
    end_s = time.monotonic() + DOOR_WITHIN_S
    while True:
        endpoint = records.endpoint_of(record)
        if endpoint is not None:
            return OwnerConnection.connect(endpoint, record.case_id)
        if not records.is_held(record) or time.monotonic() >= end_s:
            return None
        time.sleep(POLL_INTERVAL_S)


def _checked_saving_info(settled: Settled) -> SavingInfo:
    """Return the saving info in an owner's reply; raise CarinaError if the live file lacks the latest changes."""
    if settled.unsaved is not None:
        raise CarinaError(f"the latest changes to this case cannot be read: {settled.unsaved}", code="case.not-saved")
    return settled.saving


def _named_file_path(saving: SavingInfo) -> Path | None:
    """Return the path of the named file that a saving info states; None if the case has no named file."""
    if saving.copy_name is None or saving.copy_folder is None:
        return None
    return Path(saving.copy_folder) / saving.copy_name


def _is_sight(command: c.Command) -> bool:
    """Return whether a command changes only display settings (`Sight`), separate for each window and program."""
    return isinstance(command, c.SetCrosshair) or command.sets in Sight.__struct_fields__
