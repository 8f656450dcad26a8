"""Fixtures of the browser tests: one browser and one host of real workstations for each worker.

Every page records the errors that its scripts log.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from typing import Any

import pytest
from server_process import Host, Server
from workstation import FLAGS, PICTURE_MS, Workstation, open_page

import carina
from cached_test_data import cached_phantom
from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")

FAILED = pytest.StashKey[bool]()


class Shared:
    """Browser, host of workstations and pages that the browser tests of a worker share."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self._browser: Any = None
        self._host: Host | None = None
        self._pages: dict[tuple[str, ...], Workstation] = {}

    def browser(self, path: str) -> Any:
        """Return the worker's running browser, or start the browser program at ``path``."""
        if self._browser is None:
            sync_api.expect.set_options(timeout=PICTURE_MS)
            playwright = self._open.enter_context(sync_api.sync_playwright())
            self._browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
            self._open.callback(self._browser.close)
        return self._browser

    def host(self, factory: pytest.TempPathFactory) -> Host:
        """Return the worker's running host of workstations, or start one."""
        if self._host is None:
            self._host = Host(factory.mktemp("host"))
            self._open.callback(self._end, self._host)
        return self._host

    def _end(self, host: Host) -> None:
        assert host.end() == 0

    def page(self, browser: Any, scripts: tuple[str, ...]) -> Workstation:
        """Return an unchanged page of an earlier test, or a new page.

        A new page compiles the client again, in a separate process; this takes two thirds of the time of opening a
        case.
        """
        station = self._pages.pop(scripts, None)
        return open_page(browser, scripts) if station is None else station

    def give_back(self, station: Workstation, scripts: tuple[str, ...]) -> None:
        """Store the page for the next test with the same scripts; close a page that the test changed permanently."""
        if scripts not in self._pages and station.leave():
            self._pages[scripts] = station
        else:
            station.page.context.close()

    def close(self) -> None:
        """Close the browser, the host and the pages.

        Playwright runs an event loop in this thread, which would disturb tests of other folders. The host uses half a
        gigabyte of memory.
        """
        self._browser = self._host = None
        self._pages.clear()
        self._open.close()


SHARED = Shared()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Record whether a test failed, for its fixtures."""
    report = yield
    item.stash[FAILED] = item.stash.get(FAILED, False) or report.failed
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Any:
    """Close the shared browser and host after the last browser test."""
    try:
        return (yield)
    finally:
        if nextitem is None or nextitem.get_closest_marker("browser") is None:
            SHARED.close()


@pytest.fixture
def browser() -> Any:
    """Return the browser of the worker; tests create contexts in it."""
    path = find_browser()
    if path is None:
        pytest.skip("needs a Chromium or Chrome (Debian package: chromium)")
    return SHARED.browser(path)


@pytest.fixture
def host(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """Return the process in which the workstations of this worker run, one at a time."""
    return SHARED.host(tmp_path_factory)


@pytest.fixture(scope="session")
def shared_chest(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., dict[str, Any]]:
    """Return a function that writes the CT of a phantom once per worker, and returns the arguments of ``Host.open``.

    No test may change the file, because the host caches its volume and what is computed from the volume.
    """

    @cache
    def write(options: str) -> str:
        folder = tmp_path_factory.mktemp("chest")
        carina.write_phantom(cached_phantom(**json.loads(options)), folder)
        return str(folder / "ct.nii.gz")

    return lambda **options: {"path": write(json.dumps(options, sort_keys=True)), "is_shared": True}


@pytest.fixture
def opens() -> dict[str, Any]:
    """Return the arguments of ``Host.open``: which case the workstation opens, and options."""
    return {"demo": "phantom"}


@pytest.fixture
def server(host: Host, opens: dict[str, Any]) -> Iterator[Server]:
    """Return a new workstation, as after ``carina demo phantom`` or with the arguments of ``opens``."""
    running = host.open(**opens)
    yield running
    host.close(running)
    assert running.errors() == []


@pytest.fixture
def has_failed(request: pytest.FixtureRequest) -> Callable[[], bool]:
    """Return a function that states, during the teardown, whether the test failed."""
    return lambda: request.node.stash.get(FAILED, False)


@pytest.fixture
def scripts() -> tuple[str, ...]:
    """Return the scripts that run in the page before the client."""
    return ()


@pytest.fixture
def workstation(
    browser: Any, scripts: tuple[str, ...], request: pytest.FixtureRequest, has_failed: Callable[[], bool]
) -> Iterator[Workstation]:
    """Return an empty page without a workstation and without a cookie."""
    station = SHARED.page(browser, scripts)
    yield station
    if has_failed():
        station.failed(request.node.name)
        station.page.context.close()
    else:
        SHARED.give_back(station, scripts)
