"""Tests of the members of a cluster: new renderers get a lane, departing ones release their machine.

Ray is simulated.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest
from ray_cluster import wait_for

import carina
from carina.cluster import Console, ray_backend
from carina.cluster.ray_backend import SLOW_START_S, RayCluster

HELLO = {
    "host": "machine",
    "threads": 4,
    "simd": "portable",
    "version": carina.__version__,
    "pid": 1,
    "tokens": [],
    "memory_bytes": None,
}


class Actor:
    """Simulated Ray actor of a renderer: it occupies its machine until it is killed, and the test lets it reply."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.hello: Future = Future()
        self.num_kills = 0
        call = SimpleNamespace(remote=lambda: SimpleNamespace(future=lambda: self.hello))
        self.ping = SimpleNamespace(options=lambda **_: call)

    def says(self, **changes) -> None:
        """Reply to the first call; this shows that the renderer has started."""
        self.hello.set_result(HELLO | changes)


@dataclass
class PlayedRay:
    """Simulation of the parts of Ray that the membership uses."""

    nodes_there: list[str] = field(default_factory=lambda: ["a"])
    actors: list[Actor] = field(default_factory=list)
    may_start: threading.Event = field(default_factory=threading.Event)
    """Event for which each request for a renderer waits; it is set at the start of a test."""
    num_requests: int = 0

    def __post_init__(self) -> None:
        self.may_start.set()
        self.util = SimpleNamespace(
            scheduling_strategies=SimpleNamespace(NodeAffinitySchedulingStrategy=lambda node, soft: node)
        )

    def is_initialized(self) -> bool:
        return True

    def nodes(self) -> list[dict]:
        return [
            {"Alive": True, "NodeID": name, "NodeManagerAddress": name, "Resources": {"renderer": 1.0}}
            for name in list(self.nodes_there)
        ]

    def remote(self, **_):
        return lambda _host_class: SimpleNamespace(
            options=lambda scheduling_strategy: SimpleNamespace(remote=lambda **_: self._actor(scheduling_strategy))
        )

    def _actor(self, node: str) -> Actor:
        self.num_requests += 1
        assert self.may_start.wait(60.0)
        self.actors.append(Actor(node))
        return self.actors[-1]

    def kill(self, actor: Actor, *, no_restart: bool) -> None:
        assert no_restart
        assert not threading.current_thread().name.startswith("ray's own"), "the call would wait for its own thread"
        actor.num_kills += 1

    def all_given_back(self) -> bool:
        return all(actor.num_kills for actor in self.actors)


@pytest.fixture
def ray(monkeypatch) -> PlayedRay:
    played = PlayedRay()
    monkeypatch.setattr(ray_backend, "_import_ray", lambda token: played)
    return played


@pytest.fixture
def join(ray, consoles, tmp_path):
    """Return a function that connects a console to the simulated cluster and returns both."""
    made = []

    def joined(**options) -> tuple[Console, RayCluster]:
        console = consoles()
        made.append(RayCluster(console, "10.0.0.1:6379", tmp_path / "token", poll_s=0.005, **options))
        return console, made[-1]

    yield joined
    for cluster in made:
        cluster.close()


def names(console) -> list[str]:
    return [member.name for member in console.status().members if member.name != "console"]


def in_rays_thread(what) -> None:
    """Call a function in a thread that, like that of Ray's callbacks, must not wait for Ray."""
    thread = threading.Thread(target=what, name="ray's own")
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive()


def test_renderer_that_has_started_gets_a_lane_and_releases_its_machine_on_close(ray, join):
    console, cluster = join()
    [actor] = wait_for(lambda: list(ray.actors))
    assert names(console) == []
    in_rays_thread(actor.says)
    wait_for(lambda: names(console) == ["a"])
    cluster.close()
    assert names(console) == []
    assert ray.all_given_back()


@pytest.mark.parametrize("version", [carina.__version__, "0.0.1"])
def test_renderer_still_starting_on_close_releases_its_machine(ray, join, version):
    console, cluster = join()
    [actor] = wait_for(lambda: list(ray.actors))
    cluster.close()
    assert ray.all_given_back(), "the machine is in use while the renderer exists"
    # A reply after the closing of the console is ignored.
    in_rays_thread(lambda: actor.says(version=version))
    assert names(console) == []
    assert console.status().notices == ()


def test_renderer_requested_while_the_console_closes_is_stopped(ray, join):
    ray.may_start.clear()
    _, cluster = join()
    wait_for(lambda: ray.num_requests == 1)
    closing = threading.Thread(target=cluster.close)
    closing.start()
    wait_for(cluster._stopping.is_set)
    ray.may_start.set()
    closing.join(60.0)
    assert not closing.is_alive()
    assert len(ray.actors) == 1 and ray.all_given_back()


def test_machine_that_leaves_while_its_renderer_starts_gets_no_lane(ray, join):
    console, _ = join()
    [actor] = wait_for(lambda: list(ray.actors))
    ray.nodes_there.remove("a")
    wait_for(ray.all_given_back)
    in_rays_thread(actor.says)
    wait_for(lambda: "the machine a has left the cluster" in console.status().notices)
    assert names(console) == []
    # The machine returns, and a new renderer is requested.
    ray.nodes_there.append("a")
    wait_for(lambda: len(ray.actors) == 2)
    in_rays_thread(ray.actors[1].says)
    wait_for(lambda: names(console) == ["a"])


def test_machine_with_another_carina_version_is_reported_once_and_released(ray, join):
    console, _ = join()
    [actor] = wait_for(lambda: list(ray.actors))
    in_rays_thread(lambda: actor.says(version="0.0.1"))
    [notice] = wait_for(lambda: console.status().notices)
    assert "runs Carina 0.0.1" in notice
    assert ray.all_given_back()
    ray.nodes_there.append("b")
    wait_for(lambda: len(ray.actors) == 2)
    assert ray.actors[1].node == "b", "no second renderer is requested on it"


@pytest.mark.parametrize("answer", ["fails", "makes no sense"])
def test_renderer_that_cannot_start_is_reported_stopped_and_requested_again(ray, join, monkeypatch, answer):
    monkeypatch.setattr(ray_backend, "WAIT_AFTER_FAILURE_S", 0.0)
    console, _ = join()
    [actor] = wait_for(lambda: list(ray.actors))
    if answer == "fails":
        in_rays_thread(lambda: actor.hello.set_exception(RuntimeError("no core")))
    else:
        in_rays_thread(lambda: actor.hello.set_result({"version": carina.__version__}))
    [notice] = wait_for(lambda: console.status().notices)
    assert "the renderer on a could not be started" in notice
    wait_for(lambda: len(ray.actors) == 2)
    assert actor.num_kills == 1
    in_rays_thread(ray.actors[1].says)
    wait_for(lambda: names(console) == ["a"])


def test_renderer_that_starts_slowly_is_reported_and_used_once_it_has_started(ray, join):
    now_s = [100.0]
    console, _ = join(clock=lambda: now_s[0])
    [actor] = wait_for(lambda: list(ray.actors))
    now_s[0] += SLOW_START_S - 1.0
    ray.nodes_there.append("b")
    wait_for(lambda: len(ray.actors) == 2)
    assert console.status().notices == ()
    now_s[0] += 2.0
    [notice] = wait_for(lambda: console.status().notices)
    assert "the renderer on a has not started after 30 s: another console" in notice
    ray.nodes_there.append("c")
    wait_for(lambda: len(ray.actors) == 3)
    assert console.status().notices == (notice,), "the notice is reported once and there is no other"
    in_rays_thread(actor.says)
    wait_for(lambda: names(console) == ["a"])


def test_closing_the_console_before_the_cluster_releases_each_renderer_once(ray, join):
    console, cluster = join()
    wait_for(lambda: ray.actors)
    console.close()
    cluster.close()
    assert ray.all_given_back()


def test_renderer_that_starts_after_the_console_closed_releases_its_machine(ray, join):
    console, _ = join()
    [actor] = wait_for(lambda: list(ray.actors))
    console.close()
    in_rays_thread(actor.says)
    wait_for(ray.all_given_back)
