"""Tests of the start and the end of the workstation as a process."""

from __future__ import annotations

import asyncio
import errno
import importlib
import json
import signal
import socket
import subprocess
import sys

import httpx
import pytest
from websockets.sync.client import connect

from carina.errors import CarinaError, UsageError, VolumeImportError
from carina.render import Renderer, transfer_preset
from carina.server import serve
from carina.server.serve import _load_dicom_readers, bind
from carina.server.wire import messages as wire
from small_case import small_volume
from user_folders import environment_in, user_folders

WAIT_S = 120.0
"""Upper limit of a wait, in seconds: the import of SimpleITK takes seconds on a busy machine."""


def test_start_with_a_path_and_a_demo_or_with_an_unknown_demo_is_refused():
    with pytest.raises(UsageError, match="found both"):
        serve("x", demo="phantom")
    with pytest.raises(UsageError, match="'phantom' or 'patient'"):
        serve(None, demo="ghost")


def test_unreadable_path_is_refused_before_a_server_starts(tmp_path):
    (tmp_path / "holiday.pdf").write_bytes(b"%PDF-1.7\n%%EOF")
    ready = []
    with pytest.raises(VolumeImportError, match=r"holiday\.pdf"):
        serve(str(tmp_path / "holiday.pdf"), open_browser=False, on_ready=lambda *arguments: ready.append(arguments))
    with pytest.raises(VolumeImportError):
        serve(str(tmp_path / "nothing-here"), open_browser=False, on_ready=lambda *arguments: ready.append(arguments))
    assert ready == []


def test_modules_that_cannot_be_loaded_in_the_background_cause_no_traceback(monkeypatch):
    """Check the failure of a process without a free file descriptor: the modules are loaded again when needed."""

    class NoDescriptor:
        def find_spec(self, name, path=None, target=None):
            if name == "carina.volume.dicom":
                raise OSError(errno.EMFILE, "Too many open files", name)

    monkeypatch.delitem(sys.modules, "carina.volume.dicom", raising=False)
    monkeypatch.setattr(sys, "meta_path", [NoDescriptor(), *sys.meta_path])
    with pytest.raises(OSError, match="Too many"):
        importlib.import_module("carina.volume.dicom")
    _load_dicom_readers()


def test_websockets_send_small_messages_without_delay():
    """Check that a picture does not wait up to 40 ms for the acknowledgement of the previous message."""

    async def at_once() -> bool:
        found: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        async def connected(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            found.set_result(writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with bind("127.0.0.1", 0) as listening:
            async with await asyncio.start_server(connected, sock=listening):
                _, writer = await asyncio.open_connection(*listening.getsockname())
                async with asyncio.timeout(60.0):
                    answer = await found
                writer.close()
        return answer != 0

    assert asyncio.run(at_once())


def test_port_in_use_is_reported_before_a_case_is_opened():
    with bind("127.0.0.1", 0) as taken, pytest.raises(CarinaError, match="is in use"):
        serve(None, port=taken.getsockname()[1], open_browser=False)


def test_workstation_with_a_cluster_renders_videos_on_this_machine(monkeypatch, tmp_path):
    for name, folder in user_folders(tmp_path).items():
        monkeypatch.setenv(name, folder)
    given = {}

    class StartedError(Exception):
        pass

    def session(renderer_factory, **options):
        given.update(options, views=renderer_factory)
        raise StartedError

    def make_cluster_renderer(_volume, _transfer):
        raise AssertionError("the cluster renders only views")

    monkeypatch.setattr(sys.modules[serve.__module__], "Session", session)
    with pytest.raises(StartedError):
        serve(None, open_browser=False, make_renderer=make_cluster_renderer)
    assert given["views"] is make_cluster_renderer
    assert isinstance(given["job_renderer_factory"](small_volume(), transfer_preset("endoscopic")), Renderer)


def test_external_program_connects_repeatedly_with_the_printed_token(tmp_path):
    environment = environment_in(tmp_path)
    command = [sys.executable, "-m", "carina.cli", "open", "--no-browser", "--json"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            text = ""
            while not text.rstrip().endswith("}"):
                line = process.stdout.readline()
                assert line, process.stderr.read()
                text += line
            result = json.loads(text)
            assert set(result) == {"url", "token"}
            assert result["token"] not in result["url"]
            base = result["url"].partition("/?")[0]
            bearer = {"Authorization": f"Bearer {result['token']}"}
            for _ in range(2):
                assert httpx.post(f"{base}/api/upload", headers=bearer, timeout=WAIT_S).status_code == 201
                with connect(f"ws{base[4:]}/ws", additional_headers=bearer, open_timeout=WAIT_S) as socket:
                    socket.send(wire.encode_message(wire.ClientHello(wire.WIRE_VERSION)))
                    assert json.loads(socket.recv(timeout=WAIT_S))["type"] == "hello"
            # The token for programs is not accepted as start token, and the start token not as bearer token.
            assert httpx.get(f"{base}/?token={result['token']}", timeout=WAIT_S).status_code == 403
            start = result["url"].partition("token=")[2]
            wrong = {"Authorization": f"Bearer {start}"}
            assert httpx.post(f"{base}/api/upload", headers=wrong, timeout=WAIT_S).status_code == 403
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=WAIT_S)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "", "")


def test_server_process_prints_a_link_that_works_again_for_its_user_and_ends_without_an_error(tmp_path):
    program = (
        "from carina.server import serve\n"
        "raise SystemExit(serve(None, open_browser=False, on_ready=lambda url, token: print(url, flush=True)))"
    )
    environment = environment_in(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            url = process.stdout.readline().strip()
            assert url.startswith("http://127.0.0.1:")
            # The test runs as the same user; the tests of the access checks try other users.
            for _ in range(2):
                assert httpx.get(url, timeout=WAIT_S).status_code == 303
            assert httpx.get(url.replace("token=", "token=x"), timeout=WAIT_S).status_code == 403
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=WAIT_S)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "", "")
