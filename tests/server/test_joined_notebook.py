"""Tests of programs that join the case of a window: shared edits, separate view settings, takeover, access control."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from live_server import Live, serving
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import carina
from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile, CaseFileError
from carina.config import load_settings
from carina.errors import CarinaError, DiskError, NoEvidenceError, NoResultError, UnsavedWorkError, UsageError
from carina.render import Renderer
from carina.server.attached_programs import JoinedProgram, endpoint_of, problem_message
from carina.server.files.uploads import Limits, Uploads
from carina.server.network.access_checks import Gate
from carina.server.wire import messages as wire
from carina.session import ErrorEvent, EvidenceMissing, Session, case_files
from carina.session.attach.client import error_from_problem
from carina.session.store.attach_endpoint import ENDPOINT_FILE, AttachEndpoint, read_endpoint, write_endpoint
from carina.session.store.registry import CaseRecords
from carina.volume import write_grid
from user_folders import environment_in, user_folders

WAIT_S = 120.0


@pytest.fixture(scope="module")
def made_folder(tmp_path_factory):
    """Return a folder with a CT, and with user folders in which a case of the CT was begun."""
    folder = tmp_path_factory.mktemp("join")
    volume = cached_phantom(spacing_mm=3.0, generations=3).volume
    write_grid(folder / "ct.nii.gz", volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
    with pytest.MonkeyPatch.context() as patch:
        for name, place in user_folders(folder / "home").items():
            patch.setenv(name, place)
        with workstation() as window:
            window.do(c.OpenPath(str(folder / "ct.nii.gz")))
    return folder


class Window:
    """Session of a running workstation, with the actions that its user can take."""

    def __init__(self, session, records, gate):
        self.session = session
        self.records = records
        self.gate = gate

    def do(self, command):
        self.session.do(command)
        assert self.session.jobs.wait_idle(WAIT_S)
        if self.state.case is not None:
            # Only a saved case has connection details for programs.
            self.session.do(c.KeepNow())

    @property
    def state(self):
        return self.session.snapshot()

    @property
    def folder(self):
        case_id, _ = self.session.cases.open_case
        return self.records.path_of(self.records.find(case_id)).parent


@contextlib.contextmanager
def workstation():
    """Run a server over a session that stores its cases, as ``carina open`` does."""
    records = CaseRecords(load_settings().cases_dir, time.time)
    session = Session(
        lambda volume, transfer: Renderer(volume, transfer=transfer), records=records, files=case_files(None, records)
    )
    with serving(session, Uploads(Limits(num_files=20, total_bytes=10_000, file_bytes=5000))) as gate:
        records.endpoint = endpoint_of(gate)
        yield Window(session, records, gate)


@pytest.fixture
def ct(made_folder, tmp_path, monkeypatch):
    """Return the path of the CT; the user folders are a new copy."""
    shutil.copytree(made_folder / "home", tmp_path / "home")
    for name, place in user_folders(tmp_path / "home").items():
        monkeypatch.setenv(name, place)
    return made_folder / "ct.nii.gz"


@pytest.fixture
def window(ct):
    with workstation() as window:
        window.do(c.OpenPath(str(ct)))
        window.do(c.SaveCase(str(load_settings().cases_dir.parent / "lunch.carina")))
        yield window


def test_edits_in_a_notebook_and_in_a_window_with_one_case_appear_in_both(window, ct):
    with carina.Case.open(ct) as case:
        assert case.note is None
        tip = case.airways.tree.tips()[0]
        assert [one.name for one in case.airways.tree.branches] == [
            one.name for one in window.state.document.airways.tree.branches
        ]
        case.do(c.EditTree(c.RenameBranch(tip.id, "from the notebook")))
        assert window.state.document.airways.tree.branch(tip.id).name == "from the notebook"
        assert case.history() == window.session.history()
        window.do(c.AddTarget(tuple(float(v) for v in tip.points[-1])))
        assert [target.name for target in case.state.document.targets] == ["Target 1"]
        window.do(c.EditTree(c.RenameBranch(tip.id, "from the window")))
        assert case.airways.tree.branch(tip.id).name == "from the window"
        case.undo()
        assert window.state.document.airways.tree.branch(tip.id).name == "from the notebook"
        window.session.undo()
        assert not case.state.document.targets
        case.redo()
        assert [target.name for target in window.state.document.targets] == ["Target 1"]
        assert [target.name for target in case.state.document.targets] == ["Target 1"]
    # The case stays open in the window.
    assert window.session.cases.open_case is not None
    window.do(c.SetFov(100.0))


def test_notebook_that_opens_a_case_file_of_a_window_joins_its_case_and_saves_it_there(window, tmp_path):
    place = load_settings().cases_dir.parent / "lunch.carina"
    with carina.Case.open(place) as case:
        assert case.path == place
        case.do(c.SetFov(100.0))
        assert case.save() == place
        with CaseFile.open(place, read_only=True) as file:
            assert len(file.history()) == 1
        with pytest.raises(UsageError, match="already") as refused:
            case.save(_file(tmp_path / "other.carina"))
        assert refused.value.code == "case.exists"
        assert case.save(tmp_path / "two") == tmp_path / "two.carina" == case.path
        with pytest.raises(UsageError, match="does not exist"):
            case.save(tmp_path / "nowhere" / "one.carina")


def _file(path):
    path.write_bytes(b"something")
    return path


def test_notebook_waits_until_a_case_that_a_window_just_opened_can_be_joined(window, ct):
    door = window.folder / ENDPOINT_FILE
    held_back = door.with_suffix(".later")
    door.rename(held_back)
    opening = threading.Timer(0.5, held_back.rename, (door,))
    opening.start()
    with carina.Case.open(ct) as case:
        assert not held_back.exists()
        assert case.note is None
        case.do(c.SetFov(100.0))
        assert window.state.document.look.fov_deg == 100.0
    opening.join()


def test_pictures_poses_and_queries_of_a_joined_notebook_use_the_newest_state(window, ct):
    with carina.Case.open(ct) as case:
        window.do(c.GoTo(30.0))
        assert np.array_equal(case.pose.lps_from_camera, window.session.pose_info().pose.lps_from_camera)
        shown = case.render("axial", width=40, height=30)
        scene = window.session.scene()
        assert np.array_equal(shown.rgb, scene.renderer.render(scene.spec("axial", 40, 30, 0.5)).rgb)
        assert case.ask(c.VoxelAt(tuple(case.pose.position_lps))) is not None
        case.do(c.GoTo(60.0))
        assert window.session.pose_info().path_mm == pytest.approx(60.0)


def test_joined_notebook_has_separate_view_settings(window, ct):
    with carina.Case.open(ct) as case:
        centre = tuple(float(v) for v in case.volume.centre_lps)
        case.do(c.SetCrosshair(centre))
        case.do(c.SetTexture(on=False))
        window.do(c.SetShading(on=False))
        assert window.state.sight.crosshair_lps is None
        assert window.state.sight.texture
        assert case.state.sight.crosshair_lps == centre
        assert not case.state.sight.texture
        assert case.state.sight.shading


def test_errors_of_a_joined_case_are_raised_in_the_notebook_as_without_a_window(window, ct):
    with carina.Case.open(ct) as case:
        before = case.history()
        with pytest.raises(UsageError, match=r"set_fov\.fov_deg must be at least 60") as refused:
            case.do(c.SetFov(1.0))
        assert refused.value.code == "command.bounds"
        with pytest.raises(UsageError, match="has been removed"):
            case.do(c.RemoveTarget("target-77"))
        far = tuple(float(v) for v in np.add(case.volume.centre_lps, (60.0, 60.0, 0.0)))
        with pytest.raises(NoResultError):
            case.do(c.EditTree(c.AddBranch(far)))
        with pytest.raises(UsageError, match="in the window"):
            case.do(c.CloseCase())
        with pytest.raises(UsageError, match="cannot be sent"):
            case.do(c.TakeMask("mask.nii.gz"))
        assert case.history() == before
        case.do(c.SetFov(100.0))


def test_each_program_receives_only_its_own_errors(window, ct):
    heard = []
    window.session.subscribe(heard.append, window=1)
    with carina.Case.open(ct) as one, carina.Case.open(ct) as other:
        far = tuple(float(v) for v in np.add(one.volume.centre_lps, (60.0, 60.0, 0.0)))
        with pytest.raises(NoResultError):
            one.do(c.EditTree(c.AddBranch(far)))
        other.do(c.SetFov(100.0))
        assert one.state.document.look.fov_deg == 100.0
        assert one.history() == other.history()
    assert not [event for event in heard if isinstance(event, ErrorEvent | EvidenceMissing)]


def test_window_and_notebook_show_each_other_s_changes_except_view_settings(window, ct):
    live = Live(window.gate, window.session, None, [])
    with live.window() as page, carina.Case.open(ct) as case:
        tip = case.airways.tree.tips()[0]
        case.do(c.EditTree(c.RenameBranch(tip.id, "from the notebook")))
        named = (tip.id, "from the notebook")
        page.until(lambda m: isinstance(m, wire.Tree) and named in {(one.id, one.name) for one in m.tree.branches})
        page.received(lambda m: isinstance(m, wire.HistoryMessage) and len(m.steps) == 1)
        page.send(wire.SetOutline("none"))
        page.until_state(lambda state: state.look.outline == "none")
        assert case.state.document.look.outline == "none"
        # View settings are not shared.
        case.do(c.SetTexture(on=False))
        page.send(wire.SetShading(False))
        page.until_state(lambda state: not state.sight.shading)
        assert page.seen[-1].sight.texture
        assert case.state.sight.shading


# ---------------------------------------------------------------- the owner closes the case


def test_joined_notebook_continues_when_the_window_is_closed(ct):
    with workstation() as window:
        window.do(c.OpenPath(str(ct)))
        case = carina.Case.open(ct)
        tip = case.airways.tree.tips()[0]
        case.do(c.EditTree(c.RenameBranch(tip.id, "one")))
    with pytest.warns(UserWarning, match="this program has taken over"):
        assert case.airways.tree.branch(tip.id).name == "one"
    case.do(c.EditTree(c.RenameBranch(tip.id, "two")))
    case.undo()
    case.redo()
    assert case.state.saving.keeps
    case.close()
    with workstation() as window:
        window.do(c.OpenPath(str(ct)))
        assert window.state.document.airways.tree.branch(tip.id).name == "two"
        assert len(window.session.history()) == 2


def test_joined_notebook_continues_its_case_when_another_case_is_opened_in_the_window(window, ct, tmp_path):
    with carina.Case.open(ct) as case:
        window.do(c.CloseCase())
        with pytest.warns(UserWarning, match="has taken over"):
            case.do(c.SetFov(100.0))
        assert case.state.document.look.fov_deg == 100.0
        # Now the notebook owns the case.
        window.do(c.OpenPath(str(ct)))
        assert window.state.document.look.fov_deg != 100.0


def test_one_of_two_joined_notebooks_takes_over_the_case_and_the_other_reports_it(ct):
    with workstation() as window:
        window.do(c.OpenPath(str(ct)))
        one, other = carina.Case.open(ct), carina.Case.open(ct)
    for case in (one, other):
        with pytest.warns(UserWarning, match="program that had this case open has ended"):
            case.do(c.SetFov(100.0))
    assert sorted(case.note is None for case in (one, other)) == [False, True]
    loser = next(case for case in (one, other) if case.note is not None)
    with pytest.raises(UsageError, match="another name"):
        loser.save()
    next(case for case in (one, other) if case is not loser).close()
    with pytest.raises(UnsavedWorkError, match="1 change"):
        loser.close()


# ---------------------------------------------------------------- a workstation that is killed


@pytest.mark.skipif(os.name == "nt", reason="a signal kills it")
def test_joined_notebook_continues_when_the_workstation_is_killed(ct, tmp_path):
    stations = Workstations(ct, tmp_path)
    try:
        stations.start()
        case = carina.Case.open(ct)
        tip = case.airways.tree.tips()[0]
        case.do(c.EditTree(c.RenameBranch(tip.id, "before")))
        assert stations.kill() == -signal.SIGKILL
        # The first call after the kill is executed, and only once.
        with pytest.warns(UserWarning, match="this program has taken over"):
            case.do(c.AddTarget(tuple(float(v) for v in tip.points[-1])))
        assert case.airways.tree.branch(tip.id).name == "before"
        assert [target.name for target in case.state.document.targets] == ["Target 1"]
        assert len(case.history()) == 2
        case.undo()
        assert not case.state.document.targets
        case.redo()
        case.close()
        # The next workstation finds all changes.
        stations.start()
        with carina.Case.open(ct) as again:
            assert len(again.history()) == 2
            assert again.airways.tree.branch(tip.id).name == "before"
    finally:
        stations.end()


class Workstations:
    """Real workstations in separate processes, started one after the other."""

    def __init__(self, ct, home):
        self._ct, self._home = ct, home
        self._process = None

    def start(self):
        message = (
            "from carina.server import serve; import sys; "
            "serve(sys.argv[1], open_browser=False, on_ready=lambda url, token: print('ready', flush=True))"
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", message, str(self._ct)],
            stdout=subprocess.PIPE,
            text=True,
            env=environment_in(self._home / "home"),
        )
        assert self._process.stdout.readline() == "ready\n"
        records = CaseRecords(load_settings().cases_dir, time.time)
        end_s = time.monotonic() + WAIT_S
        # The window opens while the workstation reads the CT.
        while not any(records.endpoint_of(one) for one in records.all()):
            assert time.monotonic() < end_s
            time.sleep(0.01)

    def kill(self):
        with self._process as process:
            process.kill()
            return process.wait(WAIT_S)

    def end(self):
        if self._process is not None and self._process.poll() is None:
            self.kill()


# ---------------------------------------------------------------- access control


def test_connection_details_of_a_case_are_private_and_removed_when_the_case_is_closed(ct):
    with workstation() as window:
        window.do(c.OpenPath(str(ct)))
        folder = window.folder
        door = read_endpoint(folder)
        assert door.url == f"ws://127.0.0.1:{window.gate.port}/join"
        assert (folder / ENDPOINT_FILE).stat().st_mode & 0o077 == 0
        assert door.token not in repr(door)
        for path in folder.iterdir():
            assert path.name == ENDPOINT_FILE or door.token.encode() not in path.read_bytes()
        window.do(c.CloseCase())
        assert not (folder / ENDPOINT_FILE).exists()


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("127.0.0.1", "ws://127.0.0.1:80/join"),
        ("::1", "ws://[::1]:80/join"),
        ("0.0.0.0", "ws://127.0.0.1:80/join"),
        ("::", "ws://[::1]:80/join"),
        ("192.0.2.7", None),
    ],
)
def test_programs_connect_to_an_open_case_only_through_loopback(host, url):
    assert endpoint_of(Gate(host=host, port=80)).url == url


def test_connection_details_left_by_a_crash_are_ignored(ct):
    records = CaseRecords(load_settings().cases_dir, time.time)
    (record,) = records.all()
    write_endpoint(records.path_of(record).parent, AttachEndpoint("ws://127.0.0.1:1/join", "x" * 40))
    with carina.Case.open(ct) as case:
        assert case.note is None
        assert case.history() == ()
    held = records.hold(record)
    assert records.endpoint_of(record) is None
    held.release()


def joined(window, *messages, token=None):
    """Return the messages that a joining program receives after it has sent ``messages``."""
    door = read_endpoint(window.folder)
    with connect(door.url, additional_headers={"Authorization": f"Bearer {token or door.token}"}) as socket:
        for message in messages:
            socket.send(message if isinstance(message, str) else wire.encode_message(message))
        answers = []
        try:
            while not answers or not isinstance(answers[-1], wire.Settled):
                answers.append(wire.parse_to_join_message(socket.recv(timeout=WAIT_S)))
        except ConnectionClosed as closed:
            return [*answers, closed.rcvd.code]
        return answers


def test_invalid_join_message_is_refused_with_a_close_code(window):
    case_id, _ = window.session.cases.open_case
    join = wire.Join(wire.WIRE_VERSION, case_id)
    with pytest.raises(InvalidStatus, match="403"):
        joined(window, join, token="y" * 40)
    assert joined(window, wire.Join(wire.WIRE_VERSION + 1, case_id)) == [4402]
    assert joined(window, wire.Settle(1)) == [4403]
    assert joined(window, wire.Join(wire.WIRE_VERSION, "another")) == [4410]
    assert joined(window, join, join)[-1] == 4403
    assert joined(window, join, "{")[-1] == 4400
    welcome, settled = joined(window, join, wire.SetFov(100.0), wire.Settle(7))
    assert welcome == wire.Joined(carina.__version__)
    assert settled.settle_id == 7
    assert settled.problems == ()
    assert window.state.document.look.fov_deg == 100.0


def test_commands_for_a_closed_case_do_not_change_the_case_opened_after_it(window, ct):
    case_id, number = window.session.cases.open_case
    program = JoinedProgram(window.session, number)
    window.do(c.BeginAnew())
    program.execute(wire.SetFov(100.0))
    settled = program.execute(wire.Settle(1))
    assert {problem.code for problem in settled.problems} == {"case.closed"}
    assert window.state.document.look.fov_deg != 100.0
    assert joined(window, wire.Join(wire.WIRE_VERSION, case_id)) == [4410]


def test_error_sent_over_the_wire_is_restored_with_class_code_and_data():
    way = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 3.0)])
    errors = (
        UsageError("one", code="session.branch"),
        CaseFileError("two", code="case.damaged"),
        DiskError("three", code="disk.full"),
        NoEvidenceError("four", doubtful_mm=3.0, way_lps=way, doubtful=np.array([True])),
    )
    again = [error_from_problem(problem_message(error)) for error in errors]
    assert [type(one) for one in again] == [UsageError, carina.VolumeImportError, DiskError, NoEvidenceError]
    assert [(str(one), one.code) for one in again] == [(str(one), one.code) for one in errors]
    assert np.array_equal(again[-1].way_lps, way)
    assert again[-1].doubtful.tolist() == [True]
    assert type(error_from_problem(wire.Problem("NoSuchError", "x", "five"))) is CarinaError
