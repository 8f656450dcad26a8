"""Lanes to renderers on other machines through Ray; this is the only file that imports Ray.

Ray provides membership, placement, restarts, the broadcast of volumes and the transport. Ray cannot react within the
time of a picture; :class:`carina.cluster.scheduler.StripScheduler` does.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from carina.cluster.byte_messages import open_answer, pack_order
from carina.cluster.console import Console
from carina.cluster.lanes import Answered, LaneFacts, Loaded, StripAnswer, StripOrder
from carina.cluster.node import CONSOLE_ENVIRONMENT, check_available, check_token, ray_environment
from carina.cluster.renderer_host import RendererHost
from carina.cluster.scene_data import Parcel
from carina.errors import ClusterError
from carina.version import VERSION

logger = logging.getLogger(__name__)

POLL_S = 1.0
CONNECT_S = 15.0
"""Time in seconds during which a connection to a cluster's head node is tried again if the head does not answer."""
WAIT_AFTER_FAILURE_S = 5.0
SLOW_START_S = 30.0
"""Starting time of a renderer, in seconds, from which the user is notified."""
SPARE_BYTES = 256 * 1024 * 1024
"""Memory in bytes that a machine needs in addition to the volume."""


class _RayLogHandler(logging.Handler):
    """Handler that writes Ray's log messages at DEBUG; users see the notices of the console instead."""

    def emit(self, record: logging.LogRecord) -> None:
        logger.debug("Ray: %s", record.getMessage())


def _import_ray(token: Path) -> Any:
    """Import Ray with the environment variables of the cluster, and redirect its messages to the log."""
    check_available()
    os.environ.update({**ray_environment(check_token(token)), **CONSOLE_ENVIRONMENT})
    words = logging.getLogger("ray")
    if words.propagate:
        # Ray prints processes, addresses and paths on standard error, and logs a closed connection as an error.
        words.propagate = False
        words.addHandler(_RayLogHandler())
    import ray
    import ray._private.worker as ray_worker

    # Otherwise Ray prints the output of the cluster's machines to standard output, in colours.
    ray_worker.print_to_stdstream = lambda data, *_, **__: logger.debug(
        "Ray: %s", " ".join(map(str, data.get("lines", ())))
    )
    return ray


def _connect(ray: Any, address: str, ip: str | None) -> None:
    """Join a cluster as a driver; try again for :data:`CONNECT_S`, because the machine may just be starting."""
    options: dict[str, Any] = {} if ip is None else {"_node_ip_address": ip}
    end_s = time.monotonic() + CONNECT_S
    while True:
        try:
            ray.init(
                address=address,
                namespace=f"carina-{os.getpid()}-{time.monotonic_ns()}",
                log_to_driver=False,
                configure_logging=False,
                **options,
            )
            return
        except Exception as error:
            ray.shutdown()
            if time.monotonic() > end_s:
                raise ClusterError(_connection_error(address, error), code="cluster.refused") from error
        time.sleep(1.0)


def _without_ray_wrapper(trouble: BaseException) -> BaseException:
    """Return the error that another machine raised, without the exception type that Ray adds."""
    cause = getattr(trouble, "cause", None)
    return cause if isinstance(cause, BaseException) else trouble


class _ArrayStore:
    """Large arrays in Ray's object store, stored while the current content needs them.

    Every machine fetches each one once.
    """

    def __init__(self, ray: Any) -> None:
        self._ray = ray
        self._refs: dict[int, Any] = {}
        self._lock = threading.Lock()

    def refs(self, parcel: Parcel) -> dict[int, Any]:
        """Return references to the arrays of a parcel."""
        with self._lock:
            for token in [token for token in self._refs if token not in parcel.arrays]:
                del self._refs[token]
            for token, array in parcel.arrays.items():
                if token not in self._refs:
                    self._refs[token] = self._ray.put(array)
            return {token: self._refs[token] for token in parcel.arrays}


class RayLane:
    """Lane to a renderer on another machine."""

    def __init__(self, name: str, handle: Any, cluster: RayCluster, facts: dict[str, Any], store_bytes: float) -> None:
        self.name = name
        self._handle = handle
        self._cluster = cluster
        self._store_bytes = store_bytes
        self._held: set[int] | None = None
        """Tokens of the arrays that the renderer has received; None if they are unknown, as after a restart."""
        self._facts = _facts(facts)

    @property
    def facts(self) -> LaneFacts:
        """Host, processor, memory and versions of the lane's machine."""
        return self._facts

    def load(self, parcel: Parcel, done: Loaded) -> bool:
        """Send the parts of the content that the renderer lacks; see :meth:`carina.cluster.lanes.Lane.load`."""
        light = self._held is not None and set(parcel.arrays) <= self._held
        if light:
            self._send(parcel, {}, done)
        else:
            # Large arrays are first copied into shared memory, which must not block the console's thread.
            self._cluster.loader.submit(self._load_large, parcel, done)
        return light

    def _load_large(self, parcel: Parcel, done: Loaded) -> None:
        """Send content with the large arrays that the renderer lacks; runs in a thread of the loader."""
        try:
            ping = self._cluster.ray.get(self._ping(), timeout=10.0)
            self._facts = _facts(ping)
            there = set(ping["tokens"])
            new = {token: array for token, array in parcel.arrays.items() if token not in there}
            num_bytes = sum(array.nbytes for array in new.values())
            self._check_memory(parcel, num_bytes, ping["memory_bytes"])
            refs = self._cluster.store.refs(parcel)
            self._send(parcel, {token: refs[token] for token in new}, done)
        except BaseException as error:
            done(_without_ray_wrapper(error))

    def _check_memory(self, parcel: Parcel, num_bytes: int, free_bytes: int | None) -> None:
        """Raise an error if the machine has too little free memory for the content (volume and scene)."""
        words = (
            f"the case needs {_memory_text(parcel.num_bytes)}; close other programs on that machine, or use one with "
            "more memory"
        )
        if self._store_bytes and parcel.num_bytes > self._store_bytes:
            size = _memory_text(self._store_bytes)
            msg = f"the renderer {self.name} is not used: it has only {size} for volumes; {words}"
            raise ClusterError(msg, code="cluster.memory")
        if free_bytes is not None and num_bytes + SPARE_BYTES > free_bytes:
            msg = (
                f"the renderer {self.name} is not used: it has only {_memory_text(free_bytes)} of free memory; {words}"
            )
            raise ClusterError(msg, code="cluster.memory")

    def _send(self, parcel: Parcel, new: dict[int, Any], done: Loaded) -> None:
        """Send content and the references of new arrays to the renderer."""
        tokens = list(new)
        cached_tokens = [token for token in parcel.arrays if token not in new]
        ref = self._handle.load.remote(parcel.content, parcel.skeleton, cached_tokens, tokens, *new.values())

        def loaded(future: Future[Any]) -> None:
            error = future.exception()
            if error is None:
                self._held = set(parcel.arrays)
                done(None)
            else:
                self._held = None
                done(_without_ray_wrapper(error))

        ref.future().add_done_callback(loaded)

    def submit(self, order: StripOrder, done: Answered) -> None:
        """Render a strip on the other machine; see :meth:`carina.cluster.lanes.Lane.submit`."""

        def answered(future: Future[Any]) -> None:
            error = future.exception()
            if error is not None:
                self._held = None
                done(_without_ray_wrapper(error))
                return
            try:
                done(StripAnswer.of(open_answer(future.result())))
            except ClusterError as nonsense:
                done(nonsense)

        try:
            ref = self._handle.answer.remote(pack_order(order.frame_id, order.content, order.view_bytes, order.rows))
            ref.future().add_done_callback(answered)
        except Exception as error:
            done(_without_ray_wrapper(error))

    def call(self, method: str, *arguments: Any, **options: Any) -> Any:
        """Call a method of the renderer and wait for its result, for tests and benchmarks."""
        return self._cluster.ray.get(getattr(self._handle, method).remote(*arguments, **options), timeout=60.0)

    def _ping(self) -> Any:
        return self._handle.ping.options(concurrency_group="control").remote()

    def close(self) -> None:
        """End the renderer of the lane."""
        self._cluster.end(self._handle)


def _facts(ping: dict[str, Any]) -> LaneFacts:
    return LaneFacts(int(ping["threads"]), str(ping["simd"]), str(ping["host"]), str(ping["version"]), int(ping["pid"]))


def _memory_text(num_bytes: float) -> str:
    return f"{num_bytes / 2**30:.1f} GiB" if num_bytes >= 2**30 else f"{num_bytes / 2**20:.0f} MiB"


@dataclass(slots=True, eq=False)
class _StartedRenderer:
    """Renderer process on another machine, from its start to its end."""

    node: str
    store_bytes: float
    handle: Any
    began_s: float
    has_answered: bool = False


class RayCluster:
    """Watcher of a cluster: it adds a lane for each machine that joins and removes the lane when the machine leaves.

    Parameters
    ----------
    console
        Gets a lane for each renderer.
    address
        ``HOST:PORT`` of the head. This machine must be in the cluster (``carina cluster start`` or ``join``).
    token
        The token file.
    mixed
        Let renderers use their graphics devices; pictures may then differ by one grey level.
    host_class, host_options
        Class and arguments of the renderer on each machine, for tests and benchmarks.
    ip
        Address of this machine in the cluster, if it has several.
    limit
        Largest number of renderers, for benchmarks.
    poll_s
        Interval in seconds between two checks of the cluster's members.
    clock
        Returns the current time in seconds, monotonic.

    Raises
    ------
    ClusterError
        ``cluster.refused`` if the head does not answer or the token is wrong; ``cluster.missing`` without Ray.
    """

    def __init__(
        self,
        console: Console,
        address: str,
        token: Path,
        *,
        mixed: bool = False,
        host_class: type[RendererHost] = RendererHost,
        host_options: dict[str, Any] | None = None,
        ip: str | None = None,
        limit: int | None = None,
        poll_s: float = POLL_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.ray = _import_ray(token)
        self._console = console
        self._clock = clock
        self._poll_s = poll_s
        self._limit = limit
        # Tests use one connection for many clusters.
        self._connected = not self.ray.is_initialized()
        if self._connected:
            _connect(self.ray, address, ip)
        console.address, console.mixed = address, mixed
        self.store = _ArrayStore(self.ray)
        self.loader = ThreadPoolExecutor(4, thread_name_prefix="carina-load")
        self._host_class = host_class
        self._host_options = {"mixed": mixed, **(host_options or {})}
        self._renderers: dict[str, _StartedRenderer] = {}
        """Renderers by name, both those that have a lane and those that are starting.

        The method that removes a renderer from this dictionary must end it, because the renderer occupies its machine,
        which has resources for one, even if no caller waits for it.
        """
        self._not_before: dict[str, float] = {}
        self._refused: set[str] = set()
        self._lock = threading.Lock()
        """Lock of the renderers; never held during a call of Ray, because Ray's thread takes it too."""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="carina-membership", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all renderers, including those that are starting, and disconnect; the cluster keeps running."""
        with self._lock:
            if self._stopping.is_set():
                return
            # After this, _start_renderer and _add_started_lane add no renderer.
            self._stopping.set()
            renderers, self._renderers = self._renderers, {}
        for name in renderers:
            self._console.remove_lane(name)
        for renderer in renderers.values():
            self.end(renderer.handle)
        self._thread.join(timeout=30.0)
        # The console closes the lanes in its own thread; its answer to status() shows that this has been done.
        with contextlib.suppress(ClusterError):
            self._console.status()
        self.loader.shutdown(wait=True, cancel_futures=True)
        if self._connected:
            self.ray.shutdown()

    def end(self, handle: Any) -> None:
        """End a renderer permanently, also one that has not started; must not be called from Ray's threads."""
        try:
            self.ray.kill(handle, no_restart=True)
        except Exception:  # The cluster may already have ended, and the renderer with it.
            logger.debug("a renderer could not be ended", exc_info=True)

    def _watch(self) -> None:
        while True:
            try:
                self._update_renderers()
            except Exception:
                logger.warning("the cluster is not responding; this machine renders alone until it does", exc_info=True)
            if self._stopping.wait(self._poll_s):
                return

    def _update_renderers(self) -> None:
        """Start renderers on machines that have joined the cluster, and remove the lanes of machines that have left."""
        places: dict[str, tuple[str, float]] = {}
        for node in self.ray.nodes():
            num = int(node["Resources"].get("renderer", 0)) if node["Alive"] else 0
            for n in range(num):
                name = node["NodeManagerAddress"] + (f" #{n + 1}" if num > 1 else "")
                places[name] = (node["NodeID"], float(node["Resources"].get("object_store_memory", 0)))
        with self._lock:
            moved = {n: r for n, r in self._renderers.items() if places.get(n, ("", 0.0))[0] != r.node}
            for name in moved:
                del self._renderers[name]
        for name, renderer in moved.items():
            self._console.notice(f"the machine {name} has left the cluster")
            self._console.remove_lane(name)
            if not renderer.has_answered:
                self.end(renderer.handle)
        for name, (node, store_bytes) in list(places.items())[: self._limit]:
            due = self._not_before.get(name, 0.0) <= self._clock()
            if name not in self._renderers and node not in self._refused and due:
                self._start_renderer(name, node, store_bytes)
        self._report_slow_starts()

    def _report_slow_starts(self) -> None:
        now_s = self._clock()
        with self._lock:
            slow = [n for n, r in self._renderers.items() if not r.has_answered and now_s - r.began_s >= SLOW_START_S]
        for name in slow:
            self._console.notice(
                f"the renderer on {name} has not started after {SLOW_START_S:g} s: another console may be using "
                "that machine, or it is very busy (`carina cluster status` shows which machines are in use); it "
                "will join once it has started"
            )

    def _start_renderer(self, name: str, node: str, store_bytes: float) -> None:
        """Start a renderer on a machine; its lane is added when the renderer has answered."""
        remote = self.ray.remote(
            num_cpus=0,
            resources={"renderer": 1},
            # Ray restarts a renderer that died; strips are issued again by Carina's scheduler, not by Ray.
            max_restarts=-1,
            max_task_retries=0,
            concurrency_groups={"control": 1},
        )
        place = self.ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)
        actor = remote(self._host_class).options(scheduling_strategy=place)
        handle = actor.remote(**self._host_options)
        renderer = _StartedRenderer(node, store_bytes, handle, self._clock())
        with self._lock:
            closed = self._stopping.is_set()
            if not closed:
                self._renderers[name] = renderer
        if closed:
            self.end(handle)
            return
        ref = handle.ping.options(concurrency_group="control").remote()
        ref.future().add_done_callback(partial(self._handle_first_answer, name, renderer))

    def _handle_first_answer(self, name: str, renderer: _StartedRenderer, ping: Future[Any]) -> None:
        """Pass a renderer's first answer to another thread, because Ray's thread must not wait for Ray."""
        with self._lock:
            # After close() the renderer has been ended, and nothing remains to be done.
            if self._renderers.get(name) is renderer:
                self.loader.submit(self._add_started_lane, name, renderer, ping)

    def _add_started_lane(self, name: str, renderer: _StartedRenderer, ping: Future[Any]) -> None:
        """Add the lane of a renderer that has started, or report why it could not start."""
        error: BaseException | None = None
        try:
            answer = ping.result()
            words = version_words(VERSION, str(answer["version"]), name)
            lane = RayLane(name, renderer.handle, self, answer, renderer.store_bytes) if words is None else None
        except Exception as failure:
            error, lane = failure, None
            words = f"the renderer on {name} could not be started: {_first_line(_without_ray_wrapper(failure))}"
        with self._lock:
            if self._renderers.get(name) is not renderer:
                # The machine has left or the cluster was closed, and the code that removed the renderer has ended it.
                return
            if lane is not None:
                renderer.has_answered = True
                # Added under the lock, so that a later removal of the lane cannot happen before its addition.
                self._console.add_lane(lane)
                return
            del self._renderers[name]
            if error is None:
                self._refused.add(renderer.node)
            else:
                self._not_before[name] = self._clock() + WAIT_AFTER_FAILURE_S
        self.end(renderer.handle)
        self._console.notice(words or "")


def read_cluster_machines(address: str, token: Path, *, ip: str | None = None) -> list[dict[str, Any]]:
    """Return the machines of a cluster with their state.

    Parameters
    ----------
    address
        ``HOST:PORT`` of the head.
    token
        The token file.
    ip
        Address of this machine in the cluster, if it has several.

    Returns
    -------
    list of dict
        For each machine ``ip``, ``alive``, ``renderers``, ``busy`` (whether a console uses it) and ``store_bytes``.

    Raises
    ------
    ClusterError
        ``cluster.refused`` as in :class:`RayCluster`.
    """
    ray = _import_ray(token)
    _connect(ray, address, ip)
    try:
        free = ray._private.state.available_resources_per_node()
        return [
            {
                "ip": node["NodeManagerAddress"],
                "alive": bool(node["Alive"]),
                "renderers": int(node["Resources"].get("renderer", 0)),
                "busy": float(free.get(node["NodeID"], {}).get("renderer", 0)) < node["Resources"].get("renderer", 0),
                "store_bytes": int(node["Resources"].get("object_store_memory", 0)),
            }
            for node in ray.nodes()
        ]
    finally:
        ray.shutdown()


def version_words(console: str, renderer: str, name: str) -> str | None:
    """Return a message about different versions on console and renderer; None if they are equal."""
    if console == renderer:
        return None

    def key(version: str) -> list[tuple[int, str]]:
        return [(int(part) if part.isdecimal() else -1, part) for part in version.replace("+", ".").split(".")]

    side = f"the machine {name}" if key(renderer) < key(console) else "this console"
    return (
        f"the machine {name} is not used: it runs Carina {renderer} and this console runs {console}, so their "
        f"images could differ; upgrade {side}"
    )


def _first_line(trouble: BaseException) -> str:
    lines = [line.strip() for line in str(trouble).splitlines() if line.strip()]
    return lines[-1] if lines else type(trouble).__name__


def _connection_error(address: str, trouble: BaseException) -> str:
    """Return the message for the user about a connection to a cluster that failed, with the likely cause."""
    text = str(trouble)
    if "version" in text.lower() and "mismatch" in text.lower():
        return (
            f"joining the cluster at {address}: the cluster uses a different version of Ray or Python; "
            f"{_first_line(trouble)}"
        )
    if "authentication" in text.lower() or "token" in text.lower():
        return (
            f"the cluster at {address} refuses this machine's token; copy the token file of the head node to "
            "this machine (`carina cluster start --head` prints its path)"
        )
    words = _first_line(trouble)
    return (
        f"the cluster at {address} is not responding, refuses the token, or does not include this machine: run "
        f"`carina cluster start --head` or `carina cluster join {address}` here first, with the token of the "
        f"head node ({words})"
    )
