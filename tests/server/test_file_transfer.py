"""Tests of uploaded and downloaded files on loopback: dropped scans and masks, exported airways, thumbnails."""

from __future__ import annotations

import asyncio
import dataclasses
import gzip
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from live_server import WAIT_S, Live, open_case, running, serving

from carina.commands import CloseCase, SeriesFiles
from carina.errors import DiskError
from carina.server.files.downloads import Downloads
from carina.server.files.uploads import Uploads
from carina.server.wire import messages as wire
from carina.session import CaseRecords, Session, case_files
from carina.volume import SeriesInfo
from small_case import SMALL_ASSESSMENT, SmallRenderer, small_airways, small_lumen, small_parts, small_volume


def test_upload_to_a_disk_that_cannot_store_it_is_refused_with_a_message(live, monkeypatch):
    def full(**_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", full)
    with live.http(authorization=f"Bearer {live.gate.secret}") as http:
        answer = http.post("/api/upload")
    assert answer.status_code == 507
    assert "the disk is full" in answer.json()["message"]


def test_export_of_airways_needs_the_cookie_and_leaves_no_file_on_the_server(live, tmp_path, monkeypatch):
    made = []

    def export(path, volume, airways):
        path.write_text(f"{path.name} {volume.shape_zyx} {len(airways.tree.branches)}")
        made.append(path)
        return path

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    with running(tmp_path / "own") as own, own.window() as window:
        with own.http() as unauthenticated:
            assert unauthenticated.get("/api/airways.stl").status_code == 401
        with own.http(cookie=own.cookie) as http:
            early = http.get("/api/airways.stl")
            assert early.status_code == 409
            assert "no case" in early.json()["message"]
            open_case(window)
            answer = http.get("/api/airways.nii.gz")
            assert answer.status_code == 200
            assert answer.headers["content-disposition"] == 'attachment; filename="airways.nii.gz"'
            assert answer.text.startswith("airways.nii.gz (")
            for wrong in (".exe", ".stl/../x", "/../../etc/passwd", ""):
                assert http.get(f"/api/airways{wrong}").status_code in {403, 404}
            # The file is removed after its last byte was sent; the next response of this connection may arrive earlier.
            (path,) = made
            deadline_s = time.monotonic() + WAIT_S
            while path.parent.exists():
                assert time.monotonic() < deadline_s, "the file stays"
                time.sleep(0.01)


def test_temporary_file_is_removed_after_a_range_request_beyond_its_end(live, tmp_path, monkeypatch):
    def export(path, *_parts):
        path.write_text("short")
        return path

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with running(tmp_path / "own") as own, own.window() as window, own.http(cookie=own.cookie) as http:
        open_case(window)
        for part in ("bytes=900-", "bytes=x-y", "bytes=0-1"):
            http.get("/api/airways.stl", headers={"range": part})
        http.head("/api/airways.stl")
        assert http.get("/api/airways.stl").text == "short"
    assert not list(tmp_path.glob("carina-*/*/airways*"))


def test_temporary_file_is_removed_if_the_server_stops_while_writing_it(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    begun, may_end = threading.Event(), threading.Event()

    def export(path, *_parts):
        begun.set()
        assert may_end.wait(WAIT_S)
        # The function writes its file at its end, as an export does.
        path.parent.mkdir(exist_ok=True)
        path.write_text("the anatomy of somebody")
        return path

    async def ends_meanwhile():
        answering = asyncio.create_task(Downloads(SimpleNamespace(ask=lambda _question: (1, 2)), export).answer(".stl"))
        await asyncio.to_thread(begun.wait, WAIT_S)
        answering.cancel()
        with pytest.raises(asyncio.CancelledError):
            await answering
        may_end.set()

    asyncio.run(ends_meanwhile())
    assert not list(tmp_path.iterdir())


def test_failed_export_is_answered_with_a_message(live, tmp_path, monkeypatch):
    def export(path, *_parts):
        path.write_text("half")
        raise DiskError("the disk is full", code="disk.full")

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with running(tmp_path / "own") as own, own.window() as window, own.http(cookie=own.cookie) as http:
        open_case(window)
        answer = http.get("/api/airways.json")
    assert answer.status_code == 507
    assert answer.json()["message"] == "the disk is full"
    assert not list(tmp_path.glob("carina-download-*"))


def test_uploaded_file_and_folder_of_the_same_name_are_both_stored(live):
    with live.http(authorization=f"Bearer {live.gate.secret}") as http:
        upload = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload}", params={"name": "a"}, content=b"1").status_code == 201
        for name in ("a/b", "a/b/c"):
            assert http.put(f"/api/upload/{upload}", params={"name": name}, content=b"2").status_code == 201
    assert sorted(p.read_bytes() for p in live.uploads.place(upload).rglob("*") if p.is_file()) == [b"1", b"2", b"2"]


def test_uploaded_folder_is_deleted_after_it_was_opened(live):
    with live.http(cookie=live.cookie, origin=live.origin) as http, live.window() as window:
        upload_id = http.post("/api/upload").json()["upload_id"]
        for name in ("s/1.dcm", "../../2.dcm"):
            assert http.put(f"/api/upload/{upload_id}", params={"name": name}, content=b"x" * 10).status_code == 201
        folder = live.uploads._uploads[upload_id].folder
        assert sorted(len(p.relative_to(folder).parts) for p in folder.rglob("*.dcm") if p.is_file()) == [1, 2]
        window.send(wire.OpenUpload(upload_id))
        # The end of the opening is announced after the removal; jobs that the opening starts may end before.
        window.until(lambda m: isinstance(m, wire.Done) and not folder.exists())
        assert live.opened == [str(folder)]
        # The answer to this message comes after the end of the job and the removal.
        window.send(wire.OpenUpload(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "upload.gone"
        assert not folder.exists()
        assert live.session.store.recent() == ()


@pytest.mark.parametrize("at", ["open_volume", "assess_ct"])
def test_dropped_series_stay_on_the_disk_while_their_ct_is_opened_and_other_files_are_dropped(tmp_path, at):
    reached, go_on, places = threading.Event(), threading.Event(), []

    def wait(name):
        if name == at:
            reached.set()
            assert go_on.wait(WAIT_S)

    def open_volume(path, _progress, _cancel):
        places.append(Path(path))
        wait("open_volume")
        volume = small_volume()
        others = (SeriesInfo("4", "CT", "lung", 30),)
        return dataclasses.replace(volume, source=dataclasses.replace(volume.source, other_series=others))

    def assess_ct(_volume, _airways):
        wait("assess_ct")
        return SMALL_ASSESSMENT

    with (
        running(tmp_path, open_volume=open_volume, assess_ct=assess_ct) as live,
        live.http(cookie=live.cookie, origin=live.origin) as http,
        live.window() as window,
    ):
        upload_id = http.post("/api/upload").json()["upload_id"]
        for name in ("1.dcm", "2.dcm"):
            http.put(f"/api/upload/{upload_id}", params={"name": name}, content=b"x")
        window.send(wire.OpenUpload(upload_id))
        assert reached.wait(WAIT_S)
        others = [http.post("/api/upload").json()["upload_id"] for _ in range(3)]
        stayed = len(list(places[0].iterdir()))
        go_on.set()
        window.until_state(lambda s: s.airways == "found")
        # The series of the open CT can still be opened; only one of the other uploads has been replaced.
        assert (stayed, len(list(places[0].iterdir()))) == (2, 2)
        assert live.session.ask(SeriesFiles()) == places[0]
        assert list(live.uploads._uploads) == [upload_id, *others[1:]]
        window.send(CloseCase())
        window.send(wire.OpenUpload(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "upload.gone"
        assert not places[0].exists()


def test_dropped_case_file_retains_its_suffix_and_is_opened_as_a_case(tmp_path):
    records = CaseRecords(tmp_path / "cases", lambda: 1_800_000_000.0)
    session = Session(SmallRenderer, parts=small_parts(), records=records, files=case_files(None, records))
    uploads = Uploads()
    with serving(session, uploads) as gate:
        live = Live(gate, session, uploads, [])
        with live.http(cookie=live.cookie, origin=live.origin) as http, live.window() as window:
            upload_id = http.post("/api/upload").json()["upload_id"]
            sent = http.put(f"/api/upload/{upload_id}", params={"name": "Mueller Anna.carina"}, content=b"not a case")
            assert sent.status_code == 201
            place = uploads.place(upload_id)
            assert place.suffix == ".carina"
            assert "Mueller" not in place.name
            window.send(wire.OpenUpload(upload_id))
            refused = window.until(lambda m: isinstance(m, wire.Error))
            assert refused.code == "case.not-a-case"
            assert "Mueller Anna.carina" in refused.message
            assert records.all() == ()


def nrrd(labels_zyx):
    """Return an NRRD file of labels on the grid of the small case, as another program writes it."""
    matrix = small_volume().lps_from_ijk
    axes = " ".join(f"({x!r},{y!r},{z!r})" for x, y, z in matrix[:3, :3].T.tolist())
    origin = "({!r},{!r},{!r})".format(*matrix[:3, 3].tolist())
    header = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {' '.join(str(n) for n in labels_zyx.shape[::-1])}\nspace directions: {axes}\n"
        f"space origin: {origin}\nkinds: domain domain domain\nendian: little\nencoding: gzip\n\n"
    )
    return header.encode() + gzip.compress(labels_zyx.tobytes())


def test_dropped_mask_is_stored_until_a_structure_is_selected_and_then_replaces_the_airways(tmp_path):
    def find_airways(volume, *, lumen_zyx=None, notes=(), **_options):
        airways = small_airways(volume)
        if lumen_zyx is not None:
            airways.lumen_zyx, airways.report, airways.threshold = lumen_zyx, list(notes), float("nan")
        return airways

    labels = small_lumen() * 3
    labels[0, 0, 0] = 1
    with running(tmp_path, find_airways=find_airways) as live, live.window() as window:
        assert open_case(window).airways_from == "search"
        with live.http(cookie=live.cookie, origin=live.origin) as http:
            upload_id = http.post("/api/upload").json()["upload_id"]
            sent = http.put(f"/api/upload/{upload_id}", params={"name": "airway.nrrd"}, content=nrrd(labels))
            assert sent.status_code == 201
        folder = live.uploads._uploads[upload_id].folder
        window.send(wire.ImportMask(upload_id))
        question = window.until_state(lambda s: s.mask_question is not None)
        assert [label.number for label in question.mask_question.labels] == [1, 3]
        assert (question.airways_from, question.can_undo) == ("search", None)
        for _ in range(2):
            live.uploads.begin()
        assert [p.suffix for p in folder.iterdir()] == [".nrrd"]
        window.send(wire.AnswerMask(3, False))
        taken = window.until_state(lambda s: s.airways_from == "mask")
        assert (taken.can_undo, taken.mask_question) == ("use the segmentation for the airways", None)
        assert (taken.airways_words, taken.lumen_threshold) == (
            "the airway lumen is an imported segmentation",
            None,
        )
        window.send(wire.Undo())
        assert window.until_state(lambda s: s.airways_from == "search").can_redo == (
            "use the segmentation for the airways"
        )
        assert not folder.exists()


def test_mask_without_an_open_case_or_without_its_upload_is_refused(live):
    with live.http(cookie=live.cookie, origin=live.origin) as http, live.window() as window:
        upload_id = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload_id}", params={"name": "m.nrrd"}, content=b"x").status_code == 201
        window.send(wire.ImportMask(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.no-case"
        window.send(wire.ImportMask(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "upload.gone"
        window.send(wire.AnswerMask(1, False))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.no-case"


def test_uploads_require_the_cookie_and_the_origin_and_are_limited_in_size(live):
    with live.http(origin=live.origin) as http:
        assert http.post("/api/upload").status_code == 401
        assert http.put("/api/upload/x").status_code == 401
    with live.http(cookie=live.cookie) as http:
        assert http.post("/api/upload").status_code == 403
    with live.http(cookie=live.cookie, origin=live.origin) as http:
        upload_id = http.post("/api/upload").json()["upload_id"]
        big = http.put(f"/api/upload/{upload_id}", params={"name": "a"}, content=b"x" * 5001)
        assert (big.status_code, big.json()["code"]) == (413, "upload.limit")
        assert http.put("/api/upload/other", params={"name": "a"}, content=b"x").status_code == 404
        assert http.delete(f"/api/upload/{upload_id}").status_code == 204
        assert http.put(f"/api/upload/{upload_id}", params={"name": "a"}, content=b"x").status_code == 404


def test_thumbnail_of_a_case_requires_the_cookie_and_is_not_cached_by_browsers(live, monkeypatch):
    pictures = {"00ff00ff00ff00ff": b"\xff\xd8\xff and more"}
    monkeypatch.setattr(live.session.cases, "picture", pictures.get)
    with live.http() as unauthenticated:
        assert unauthenticated.get("/api/cases/00ff00ff00ff00ff/picture.jpg").status_code == 401
    with live.http(cookie=live.cookie) as http:
        answer = http.get("/api/cases/00ff00ff00ff00ff/picture.jpg?made=1.000")
        assert answer.content == pictures["00ff00ff00ff00ff"]
        assert answer.headers["content-type"] == "image/jpeg"
        assert answer.headers["cache-control"] == "no-store"
        assert http.get("/api/cases/another/picture.jpg").status_code == 404
