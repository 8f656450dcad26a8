"""Real Ray cluster on loopback for tests: one head and sleeping renderers, which leave no processes."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from carina.cluster import ClusterRenderer, ClusterSettings, Console
from carina.cluster.node import Node, descendants, end_processes, make_token
from carina.render import AirwayView, Picture, Renderer
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.cluster_sleeping_renderer import position_pixels

needs_ray = pytest.mark.skipif(
    not sys.platform.startswith("linux") or importlib.util.find_spec("ray") is None,
    reason="needs Linux and Ray (make setup-tests)",
)
IP = "127.0.0.2"  # Ray replaces 127.0.0.1 by the address of the machine on the network.
VIEW = AirwayView(Pose.looking((8.0, 8.0, 8.0), (0.0, 0.0, -1.0)), width=512, height=512)


def import_path() -> dict[str, str]:
    """Return the variable that gives another process the import path of this one, with tests and benchmarks."""
    return {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def free_port() -> int:
    """Return a network port on which no program listens."""
    with socket.socket() as probe:
        probe.bind((IP, 0))
        return int(probe.getsockname()[1])


@dataclass
class Head:
    """Running head of a Ray cluster, with its token."""

    node: Node
    token: Path
    folder: Path
    """Folder of the head's files and logs."""
    seen: dict[int, str] = field(default_factory=dict)
    """Processes that the head has started, by process ID, as ``look`` found them."""
    left: list[str] = field(default_factory=list)
    """Processes of ``seen`` that still ran after the head was stopped; a test fails if there is one."""

    def look(self) -> None:
        """Store the present child processes, because a process whose parent has ended cannot be found later."""
        self.seen |= descendants(self.node.process.pid)


def alive(tree: dict[int, str]) -> list[str]:
    """Return the names of processes that still run; zombies do not count."""
    found = []
    for pid, began in tree.items():
        with contextlib.suppress(OSError):
            name, _, rest = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
            fields = rest.split()
            if fields[19] == began and fields[0] not in "ZX":
                found.append(f"{name})")
    return found


@contextlib.contextmanager
def running_head(renderers: int) -> Iterator[Head]:
    """Run a head with ``renderers`` renderers, and stop it with all its processes at the end.

    Afterwards, ``left`` lists the processes that did not end by themselves.
    """
    # Ray puts sockets into this folder, and their paths must be short; pytest's folder would be too long.
    folder = Path(tempfile.mkdtemp(prefix="ray-"))
    token = make_token(folder / "token")
    node = Node(
        token,
        head=True,
        ip=IP,
        port=free_port(),
        renderers=renderers,
        store_bytes=200 * 2**20,
        dedicated=True,
        temp_dir=folder / "ray",
        log=folder / "log",
        environment=import_path(),
    )
    head = Head(node, token, folder)
    _running.append(head)
    try:
        node.wait_ready()
        yield head
    finally:
        head.look()
        # Node.stop waits 5 s for Ray's agents and then kills them, so no process should be left for ``reap``.
        node.stop()
        _running.remove(head)
        head.left = alive(head.seen)
        end_processes(head.seen)
        shutil.rmtree(folder, ignore_errors=True)


def small_volume(size: int = 16) -> Volume:
    """Return a cubic volume of noise with ``size`` voxels on each edge."""
    hu = np.random.default_rng(5).integers(-1000, 200, (size, size, size)).astype(np.int16)
    return Volume(hu, np.eye(4))


_running: list[Head] = []
_flights: list[Flight] = []


def wait_for(what, timeout_s: float = 240.0):
    """Wait until the function returns a true value, and return it.

    After the timeout fail with the state of the cluster.
    """
    end_s = time.monotonic() + timeout_s
    while not (found := what()):
        assert time.monotonic() < end_s, how_it_is()
        time.sleep(0.02)
    return found


def how_it_is() -> str:
    """Return the state of consoles, renderers and Ray's processes for the message of a timeout."""
    text = ["nothing came of it"]
    for flight in _flights:
        with contextlib.suppress(Exception):
            status = flight.console.status()
            text += [f"member {member}" for member in status.members]
            text += [f"notice: {notice}" for notice in status.notices]
        with contextlib.suppress(Exception):
            text += [f"asked for: {name} {renderer}" for name, renderer in flight.cluster._renderers.items()]
    if _running and "ray" in sys.modules:
        import ray
        from ray._private import state

        for title, ask in (
            ("nodes", ray.nodes),
            ("resources", ray.cluster_resources),
            ("free", ray.available_resources),
            ("actors", state.actors),
        ):
            try:
                answer = ask()
            except Exception as error:
                answer = error
            lines = [f"{key}: {value}" for key, value in answer.items()] if isinstance(answer, dict) else [str(answer)]
            text += [f"{title}: {line}" for line in lines]
    for head in _running:
        for name in ("raylet.out", "gcs_server.out"):
            with contextlib.suppress(OSError):
                path = head.folder / "ray" / "session_latest" / "logs" / name
                lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
                text += [f"--- {name}", *[line for line in lines if "[state-dump]" not in line][-60:]]
        text += [f"process {name}" for name in alive(descendants(head.node.process.pid))]
    return "\n".join(text)


@dataclass
class Flight:
    """Console with renderers on a Ray cluster, and a renderer that requests pictures from the console."""

    console: Console
    renderer: ClusterRenderer
    cluster: object
    _truth: tuple | None = None

    def ready(self) -> list[str]:
        """Return the names of the renderers that are ready."""
        members = self.console.status().members
        return [m.name for m in members if m.state == "ready" and m.name != "console"]

    def check(self, picture: Picture) -> float:
        """Check that each row comes from a sleeping renderer, or from the console if no renderer was in time.

        Return the fraction of rows from sleeping renderers, 0 to 1.
        """
        assert picture.rgb.shape == (VIEW.height, VIEW.width, 3)
        if self._truth is None or self._truth[0] != self.content:
            own = Renderer(self.renderer.volume).render(VIEW).rgb
            self._truth = (self.content, position_pixels(VIEW, None, self.content), own)
        _, stood_in, own = self._truth
        theirs = np.all(picture.rgb == stood_in, axis=(1, 2))
        right = theirs | np.all(picture.rgb == own, axis=(1, 2))
        assert right.all(), f"rows {np.flatnonzero(~right)} are wrong"
        return float(theirs.mean())

    def lane(self, name: str):
        """Return the connection (lane) of the renderer ``name``."""
        return self.console._members[name].lane

    @property
    def content(self) -> int:
        """Number of the content (scene) that is shown."""
        return self.renderer._sent[1]


@contextlib.contextmanager
def flying(
    head: Head,
    host_class,
    *,
    num: int,
    volume: Volume | None = None,
    settings: ClusterSettings | None = None,
    ip: str = IP,
    limit: int | None = None,
    **options,
) -> Iterator[Flight]:
    """Run a console with ``num`` ready renderers; ``limit`` is the largest number of renderers.

    Each renderer is a process, which takes seconds to start.
    """
    from carina.cluster.ray_backend import RayCluster

    console = Console(settings, keep_jobs=True)
    cluster = RayCluster(
        console,
        head.node.address,
        head.token,
        ip=ip,
        host_class=host_class,
        host_options=options,
        poll_s=0.2,
        limit=limit,
    )
    try:
        renderer = ClusterRenderer(Renderer(volume or small_volume()), console, spread_all=True)
        renderer.prepare()
        flight = Flight(console, renderer, cluster)
        _flights.append(flight)
        wait_for(lambda: len(flight.ready()) >= num)
        yield flight
    finally:
        _flights[:] = [flight for flight in _flights if flight.cluster is not cluster]
        head.look()
        cluster.close()
        console.close()
