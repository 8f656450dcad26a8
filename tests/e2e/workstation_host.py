"""Process that opens and closes workstations by commands, one line of JSON each: ``python workstation_host.py``.

Each workstation has a separate session, server and port, as new as after ``carina demo``, with the real volumes,
renderers and parts. Only results that take seconds and never differ are cached between workstations: imports, the
volumes of the demos and of shared files, and for these volumes the airways that are found on opening, their measures
and wall, the targets of equal points, the plans of equal targets, their verdicts and their C-arm angles.

``{"open": {"demo": "phantom"}}`` is answered by ``{"number": 1, "url": URL}``, ``{"close": 1}`` by ``{"closed": 1}``,
and an error by ``{"error": TEXT}``. ``{"open": {"path": PATH, "is_shared": true}}`` opens a shared file, which never
changes. ``{"drive": 1, "offset_mm": 0.1}`` flies the running inspection of workstation 1 by a script in compressed
time. The process ends at the end of its input.
"""

from __future__ import annotations

import importlib
import itertools
import json
import pickle
import sys
import threading
import time
import traceback
import types
import zlib
from collections import OrderedDict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from carina import render
from carina.case import compression
from carina.commands import OpenDemo, OpenPath, Steer
from carina.errors import CarinaError
from carina.phone import PhoneSwitch
from carina.render import AirwayView, Backend, isoregion_cache, scene
from carina.scopes import Pose
from carina.server import hub
from carina.server.app import web_folder
from carina.server.frames import pacing
from carina.server.network.access_checks import Gate
from carina.server.serve import bind, make_server, start_url
from carina.session import CaseRecords, LocalStore, Session, case_files
from carina.session.engines import Parts, default_parts
from carina.training import Course, TaskFolder, segments_of_case

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "training"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from scripted_flights import STEP_S, Script

from cached_test_data import cached_value, found_airways, name_of
from carina_bench.training import CLASSES, TrainingCase

STARTS_S = 120.0
OPENS_S = 600.0
RATE_HZ = 15.0
"""Default target rate of airway pictures while moving, in pictures per second.

At the rate of a user, 60, each flight of a test occupies all cores, and no test needs its intermediate pictures.
"""
PER_PIXEL_S = 0.4 / (150 * 150)
"""Rendering time of a slow airway view, seconds per pixel: 0.4 s for the coarsest picture in a cell of 600 px."""
MAX_STORED_BYTES = 1 << 20

# The package exports a function with the name of the module.
serve_module: Any = importlib.import_module("carina.server.serve")


class SlowRenderer(render.Renderer):
    """Renderer that waits a fixed time for every ray of an airway view while a file exists.

    Rendering can be stopped.
    """

    slow_file: Path

    def render(self, view: Any, *, stop: Any = None, **options: Any) -> Any:
        if isinstance(view, AirwayView) and self.slow_file.exists():
            end_s = time.monotonic() + min(PER_PIXEL_S * view.width * view.height, 1.5)
            while time.monotonic() < end_s and not (stop is not None and stop.cancelled):
                time.sleep(0.002)
        return super().render(view, stop=stop, **options)


class SteadyBudget(pacing.FrameBudget):
    """Frame budget that counts the real time of a slow airway view, but limits the counted time of a fast one.

    The limit removes the influence of other programs. Without it a busy machine would show the airway view only for
    moments.
    """

    slow_file: Path | None = None

    def _at_most(self, seconds: float, rays: float) -> float:
        if self.slow_file is None or self.slow_file.exists():
            return seconds
        return min(seconds, PER_PIXEL_S / 8.0 * rays)

    # The budget uses elapsed time, because the slow airway view waits, which the CPU time of the rays does not include.
    def learn(self, level: int, pixels: int, seconds: float, rays_s: float | None = None) -> None:
        super().learn(level, pixels, self._at_most(seconds, self.levels[level].scale ** 2 * pixels))

    def learn_probe(self, scale: float, pixels: int, seconds: float, now_s: float, rays_s: float | None = None) -> None:
        super().learn_probe(scale, pixels, self._at_most(seconds, scale**2 * pixels), now_s)


class Kept:
    """Parts of a real session, with a cache of the results that are computed for a demo or a shared file."""

    def __init__(self) -> None:
        self._real = default_parts()
        self.shared_paths: set[str] = set()
        """Paths of files that never change, whose volumes are cached."""
        self._values: dict[tuple[object, ...], Any] = {}
        self._lock = threading.Lock()
        """Lock of the cache. Cached values are never released, so no other object can get the ID of a cached one."""

    def _cached(self, key: tuple[object, ...], make: Callable[[], Any]) -> Any:
        with self._lock:
            if key in self._values:
                return self._values[key]
        # The value is computed without the lock, because another case may be opened meanwhile. A cancelled or failed
        # computation is not cached.
        made = make()
        with self._lock:
            return self._values.setdefault(key, made)

    def _holds(self, value: Any) -> bool:
        with self._lock:
            return any(stored is value for stored in self._values.values())

    def open_volume(self, path: str, progress: Any, cancel: Any, **options: Any) -> Any:
        if path not in self.shared_paths or options:
            return self._real.open_volume(path, progress, cancel, **options)
        return self._cached(("file", path), lambda: self._real.open_volume(path, progress, cancel))

    def open_demo(self, name: str, progress: Any, cancel: Any) -> Any:
        return self._cached(("demo", name), lambda: self._real.open_demo(name, progress, cancel))

    def quality_words(self, volume: Any) -> Any:
        if not self._holds(volume):
            return self._real.quality_words(volume)
        return self._cached(("quality", id(volume)), lambda: self._real.quality_words(volume))

    def find_airways(self, volume: Any, *, root_lps: Any, lumen_threshold: Any, **options: Any) -> Any:
        def find() -> Any:
            return self._real.find_airways(volume, root_lps=root_lps, lumen_threshold=lumen_threshold, **options)

        # Only the search on opening is cached; a search with a root or a threshold runs again.
        if root_lps is not None or lumen_threshold is not None or "lumen_zyx" in options or not self._holds(volume):
            return find()
        # The search takes ten seconds of processor time; the hosts of all workers share the result.
        return self._cached(("airways", id(volume)), lambda: found_airways(volume))

    def measure_tree(self, volume: Any, airways: Any, **options: Any) -> Any:
        assert self._real.measure_tree is not None
        measure = self._real.measure_tree
        if not self._holds(airways):
            return measure(volume, airways, **options)
        # The measurement takes six seconds of processor time; the hosts of all workers share the result.
        name = f"measures of {name_of(volume)}"
        return self._cached(
            ("measures", id(airways)),
            lambda: cached_value(name, lambda: measure(volume, airways, **options)),
        )

    def wall_field(self, volume: Any, airways: Any, **options: Any) -> Any:
        def make() -> Any:
            return self._real.wall_field(volume, airways, **options)

        return self._cached(("wall", id(airways)), make) if self._holds(airways) else make()

    def target_from_click(self, volume: Any, at_lps: Any, **options: Any) -> Any:
        def make() -> Any:
            return self._real.target_from_click(volume, at_lps, **options)

        airways, wall = options.get("airways"), options.get("wall")
        if not self._holds(airways) or not (wall is None or self._holds(wall)):
            return make()
        rest = {name: value for name, value in options.items() if name not in {"airways", "wall", "progress"}}
        return self._cached(("target", id(airways), id(wall), pickle.dumps((tuple(at_lps), rest))), make)

    def plan_route(self, volume: Any, airways: Any, target: Any, **options: Any) -> Any:
        def make() -> Any:
            return self._real.plan_route(volume, airways, target, **options)

        wall, measures = options.get("wall"), options.get("measures")
        if not all(self._holds(one) for one in (airways, wall, measures)):
            return make()
        # A later plan of an equal target is the same object, and the product repeats no drive along its routes.
        unused = {"wall", "measures", "progress", "cancel"}
        rest = {name: value for name, value in options.items() if name not in unused}
        return self._cached(("plan", id(airways), pickle.dumps((target, rest))), make)

    def carm_angles(self, volume: Any, airways: Any, plan: Any, *, route_number: int, **options: Any) -> Any:
        def make() -> Any:
            return self._real.carm_angles(volume, airways, plan, route_number=route_number, **options)

        is_held = self._holds(airways) and self._holds(plan)
        return self._cached(("C-arm", id(airways), id(plan), route_number), make) if is_held else make()

    def judge_scopes(self, tree: Any, plan: Any, wall: Any, *, route: Any, **options: Any) -> Any:
        judge = partial(self._real.judge_scopes, route=route)
        return self._judge(
            ("scopes", [id(one) for one in plan.routes].index(id(route))), judge, tree, plan, wall, **options
        )

    def judge_pairs(self, tree: Any, plan: Any, wall: Any, **options: Any) -> Any:
        return self._judge(("pairs",), self._real.judge_pairs, tree, plan, wall, **options)

    def _judge(
        self,
        kind: tuple[object, ...],
        judge: Callable[..., Any],
        tree: Any,
        plan: Any,
        wall: Any,
        *,
        found: Callable[[Any], None],
        **options: Any,
    ) -> Any:
        """Return verdicts on a cached plan from the cache; each of them is also passed to ``found``."""
        # Other tests check the results of the drives, so these searches for all instruments are short.
        judge = partial(judge, tree, plan, wall, effort=2000.0, **options)
        if not (self._holds(plan) and self._holds(wall)):
            return judge(found=found)
        judged: list[Any] = []

        def note(verdict: Any) -> None:
            judged.append(verdict)
            found(verdict)

        rest = {name: value for name, value in options.items() if name not in {"progress", "cancel"}}
        # The tree is stored with the verdicts, so that no other tree can get its ID.
        key = (*kind, id(tree), id(plan), id(wall), pickle.dumps(rest))
        _, verdicts, shown = self._cached(key, lambda: (tree, judge(found=note), tuple(judged)))
        if not judged:
            for verdict in shown:
                found(verdict)
        return verdicts

    def parts(self) -> Parts:
        """Return the parts of a session, which use the cached results."""
        return replace(
            self._real,
            open_volume=self.open_volume,
            open_demo=self.open_demo,
            quality_words=self.quality_words,
            find_airways=self.find_airways,
            measure_tree=self.measure_tree,
            wall_field=self.wall_field,
            plan_route=self.plan_route,
            target_from_click=self.target_from_click,
            carm_angles=self.carm_angles,
            judge_scopes=self.judge_scopes,
            judge_pairs=self.judge_pairs,
        )


class Remembered:
    """Cache of the last results of pure functions, by identity of arrays and equality of other values."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._made: OrderedDict[tuple[object, ...], tuple[tuple[Any, ...], Any]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, given: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        key = tuple(id(value) if isinstance(value, np.ndarray) and value.ndim == 3 else repr(value) for value in given)
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key][1]
        made = make()
        with self._lock:
            # The arguments are stored with the result and stay alive, so that no other array can get the id of one.
            self._made[key] = given, made
            while len(self._made) > self._most:
                self._made.popitem(last=False)
        return made


class InMemoryMapCache(isoregion_cache.MapCache):
    """Map cache that does not read, check and unpack a file which it has just read."""

    maps = Remembered(4)

    def get_or_build(self, name: Any, build: Callable[[], Any]) -> Any:
        return self.maps.get(
            (name.values_zyx, name.classes), lambda: super(InMemoryMapCache, self).get_or_build(name, build)
        )


def remember_scenes() -> None:
    """Cache the walls, the tree field and the maps of the demo's airways, which saves a second for each opening."""
    for name in ("with_wall", "build_tree_field"):
        made: Callable[..., Any] = getattr(scene, name)
        last = Remembered(4)
        setattr(scene, name, lambda *given, made=made, last=last: last.get(given, lambda: made(*given)))
    scene.MapCache = InMemoryMapCache  # type: ignore[misc]


def remember_pieces() -> None:
    """Cache the compressed parts of the demo's case file, which saves 0.3 s of CPU time for each opening."""
    small = lru_cache(4096)(zlib.compress)

    def compress(content: bytes | memoryview, level: int) -> bytes:
        return small(bytes(content), level) if len(content) < MAX_STORED_BYTES else zlib.compress(content, level)

    compressor = types.SimpleNamespace(compress=compress, decompressobj=zlib.decompressobj, error=zlib.error)
    compression.zlib = compressor  # type: ignore[assignment]


def make_slow(slow_file: str) -> Any:
    """Return a factory of renderers that are slow while a file exists."""

    def make(volume: Any, transfer: Any) -> Any:
        made = SlowRenderer(volume, transfer=transfer)
        made.slow_file = Path(slow_file)
        return made

    return make


class Ports:
    """Port that all workstations use in turn, if it is free, because a browser caches compiled scripts by address."""

    first = 0

    def bind(self) -> Any:
        """Return a listening socket on loopback: on the common port, or on another one if it is in use."""
        try:
            sock = bind("127.0.0.1", self.first)
        except CarinaError:  # The port is in use, because two workstations are open at once.
            return bind("127.0.0.1", 0)
        self.first = sock.getsockname()[1]
        return sock


class ScriptedClock:
    """Clock of a session that a scripted drive can advance faster than the time of the machine."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.ahead_s


PORTS = Ports()
DRIVES: dict[int, tuple[Session, ScriptedClock]] = {}
"""Session and clock of each open workstation, by its number."""


def drive_optimally(session: Session, clock: ScriptedClock, offset_mm: float) -> int:
    """Fly the running attempt at an inspection by a script, in compressed time; return the number of poses.

    The script places the tip directly, so that the physics of the scope has no part in the flight. Command, recorder,
    scorer and learners are those of a hand.
    """
    core = session._core
    case = core.needed_case()
    airways = case.document.airways
    assert airways is not None
    parts = {
        one.name: tuple(str(airways.tree.branch(number).name) for number in one.branch_ids)
        for one in segments_of_case(airways.tree)
    }
    wall = case.wall.of(airways)
    assert wall is not None
    drive, options = CLASSES["optimal"]
    script = Script(airways.tree, offset_mm=offset_mm, **options)
    script.start()
    made = TrainingCase("window", 0, case.info.volume, airways.tree, wall.field, parts)
    drive(script, made, np.random.default_rng(1))

    def place(pose: Pose, *_amounts: float, **_times: float) -> None:
        case.navigator._pose = pose

    for matrix in script.poses:
        with core.lock:
            clock.ahead_s += STEP_S
            pose = Pose(matrix)
            navigator = case.navigator
            navigator.steer = partial(place, pose)  # type: ignore[method-assign]
            session.do(Steer(0.1, 0.0, 0.0, 0.0))
            del navigator.steer
    return len(script.poses)


def open_workstation(
    cache: Kept, stack: ExitStack, home: str, demo: str | None, path: str | None, *, number: int, **options: Any
) -> str:
    """Assemble a workstation as ``carina.server.serve`` does, and return its start URL; ``stack`` closes it."""
    if options.get("is_shared"):
        assert path is not None
        cache.shared_paths.add(path)
    sock = stack.enter_context(PORTS.bind())
    gate = Gate(host="127.0.0.1", port=sock.getsockname()[1])
    slow_file = options.get("slow_file")
    SteadyBudget.slow_file = None if slow_file is None else Path(slow_file)
    backend = Backend("cpu")
    factory = serve_module._renderer_factory(backend) if slow_file is None else make_slow(slow_file)
    store = LocalStore(Path(home))
    # The hints of the first minute would cover parts of the window; their test asks for a user who has not read them.
    if not options.get("first_use"):
        store.read_hints()
    clock = ScriptedClock()
    session = Session(
        factory,
        clock=clock,
        parts=cache.parts(),
        store=store,
        records=CaseRecords(Path(home) / "cases", time.time, Path(home) / "documents"),
        files=case_files(),
        course=Course(Path(home) / "learners"),
        tasks=TaskFolder(Path(home) / "tasks"),
    )
    DRIVES[number] = session, clock
    stack.callback(session.close)
    hub.DEFAULT_RATE_HZ = options.get("rate_hz", RATE_HZ)
    page = PhoneSwitch(session, web_folder(), options.get("phone_address"))
    stack.callback(page.stop)
    started = threading.Event()
    server = make_server(
        session,
        gate,
        on_started=started.set,
        web=web_folder(),
        patient_citation=serve_module._patient_citation(),
        build_info=serve_module._build_info(),
        phone=page,
        watch_address=options.get("phone_address"),
    )
    thread = threading.Thread(target=lambda: server.run(sockets=[sock]))
    thread.start()

    def stop() -> None:
        server.should_exit = True
        thread.join()

    stack.callback(stop)
    if not started.wait(STARTS_S):
        raise TimeoutError("the server does not start")
    changed = threading.Event()
    unsubscribe = session.subscribe(lambda _event: changed.set())
    if path is not None:
        session.do(OpenPath(path))
    elif demo is not None:
        session.do(OpenDemo(demo))
    # A page that is opened before the airways are measured receives every picture several times.
    opens = path is not None or demo is not None
    while opens and (session.jobs.running or session.snapshot().airways not in {"found", "failed"}):
        assert changed.wait(OPENS_S), "the case does not open"
        changed.clear()
    unsubscribe()
    return start_url(gate)


def main() -> None:
    """Execute the commands of standard input until it ends."""
    remember_scenes()
    remember_pieces()
    pacing.FrameBudget = SteadyBudget  # type: ignore[misc]
    cache, numbers, opened = Kept(), itertools.count(1), {}
    for line in sys.stdin:
        order = json.loads(line)
        answer: dict[str, Any]
        try:
            if "open" in order:
                stack, number = ExitStack(), next(numbers)
                opened[number] = stack
                answer = {"number": number, "url": open_workstation(cache, stack, number=number, **order["open"])}
            elif "drive" in order:
                answer = {"poses": drive_optimally(*DRIVES[order["drive"]], order["offset_mm"])}
            else:
                DRIVES.pop(order["close"], None)
                opened.pop(order["close"]).close()
                print(f"workstation {order['close']} is closed", file=sys.stderr, flush=True)
                answer = {"closed": order["close"]}
        except BaseException:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), flush=True)
    for stack in opened.values():
        stack.close()


if __name__ == "__main__":
    main()
