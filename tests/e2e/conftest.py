"""A real browser, its pages and a host of real workstations for each worker; a page remembers every error it logged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from server_process import Host, Server
from workstation import FLAGS, PICTURE_MS, Workstation, open_page

from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")

FAILED = pytest.StashKey[bool]()


class Shared:
    """One browser and one host of workstations for as long as tests come that want them."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self._browser: Any = None
        self._host: Host | None = None
        self._pages: dict[tuple[str, ...], Workstation] = {}

    def browser(self, path: str) -> Any:
        """The running one, or a new one."""
        if self._browser is None:
            sync_api.expect.set_options(timeout=PICTURE_MS)
            playwright = self._open.enter_context(sync_api.sync_playwright())
            self._browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
            self._open.callback(self._browser.close)
        return self._browser

    def host(self, factory: pytest.TempPathFactory) -> Host:
        """The running one, or a new one."""
        if self._host is None:
            self._host = Host(factory.mktemp("host"))
            self._open.callback(self._end, self._host)
        return self._host

    def _end(self, host: Host) -> None:
        assert host.end() == 0

    def page(self, browser: Any, scripts: tuple[str, ...]) -> Workstation:
        """One that an earlier test left as it was, or a new one.

        A new one compiles the client anew, in a process of its own: two thirds of what it costs to open a case.
        """
        station = self._pages.pop(scripts, None)
        return open_page(browser, scripts) if station is None else station

    def give_back(self, station: Workstation, scripts: tuple[str, ...]) -> None:
        """For the next test that wants these scripts; what was changed for good is closed."""
        if scripts not in self._pages and station.leave():
            self._pages[scripts] = station
        else:
            station.page.context.close()

    def close(self) -> None:
        """Playwright keeps an event loop in this thread, which the tests of other folders must find free; and the host
        half a gigabyte."""
        self._browser = self._host = None
        self._pages.clear()
        self._open.close()


SHARED = Shared()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Tell the fixtures whether their test failed."""
    report = yield
    item.stash[FAILED] = item.stash.get(FAILED, False) or report.failed
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Any:
    """Close what is shared after the last test that wants it."""
    try:
        return (yield)
    finally:
        if nextitem is None or nextitem.get_closest_marker("browser") is None:
            SHARED.close()


@pytest.fixture
def browser() -> Any:
    """One browser a worker; tests make contexts of it."""
    path = find_browser()
    if path is None:
        pytest.skip("needs a Chromium or Chrome (Debian package: chromium)")
    return SHARED.browser(path)


@pytest.fixture
def host(tmp_path_factory: pytest.TempPathFactory) -> Host:
    """The process in which this worker's workstations run, one at a time."""
    return SHARED.host(tmp_path_factory)


@pytest.fixture
def opens() -> dict[str, Any]:
    """What the workstation opens, and with which options: ``Host.open``."""
    return {"demo": "phantom"}


@pytest.fixture
def server(host: Host, opens: dict[str, Any]) -> Iterator[Server]:
    """A workstation as new as after ``carina demo phantom``, or what ``opens`` tells."""
    running = host.open(**opens)
    yield running
    host.close(running)
    assert running.errors() == []


@pytest.fixture
def has_failed(request: pytest.FixtureRequest) -> Callable[[], bool]:
    """Tells, on the way back, whether the test failed."""
    return lambda: request.node.stash.get(FAILED, False)


@pytest.fixture
def scripts() -> tuple[str, ...]:
    """What runs in the page before the client does."""
    return ()


@pytest.fixture
def workstation(
    browser: Any, scripts: tuple[str, ...], request: pytest.FixtureRequest, has_failed: Callable[[], bool]
) -> Iterator[Workstation]:
    """A page that shows nothing yet, knows no workstation and holds no cookie."""
    station = SHARED.page(browser, scripts)
    yield station
    if has_failed():
        station.failed(request.node.name)
        station.page.context.close()
    else:
        SHARED.give_back(station, scripts)
