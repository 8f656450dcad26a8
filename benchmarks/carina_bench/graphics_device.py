"""``python -m carina_bench.graphics_device [CASE ...]``: airway views of the CPU and of a graphics device.

Ten poses from the trachea into a segmental bronchus, in three looks: lit by the tip's light during the cast
(*tip-lit*), the window's look without decoration from the tree (*shipped*), and the window's look (*decorated*).
CPU and device render each picture alternately. The table states medians over the poses, of wall time and of the
processor time of all threads, and the largest part of a picture's pixels that differ by more than a level.
Side-by-side pictures (CPU, device, differing pixels) of three poses are written with ``--output``.

The first adapter is used, whatever its kind, so the program also runs on an adapter in software. The module must be
built with graphics support (``make test-gpu`` installs such a build in ``.venv-gpu``).
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from pathlib import Path

import numpy as np

from carina.disk import make_folder
from carina.render import AirwayView, Backend, Picture, Renderer
from carina.render.processor_choice import differing_share
from carina.scopes import DEFAULT_SCOPE, Pose, scope_preset
from carina_bench.cases import Case, open_case
from carina_bench.machine import load_average
from carina_bench.pictures import save
from carina_bench.render import shipped

__all__ = ["run"]

SIZES = ((512, 512), (1920, 1080), (3840, 2160))
"""Sizes (width, height) in pixels of the pictures that are timed."""
NUM_POSES = 10
PICTURED = (0, 4, 9)
"""Indices of the poses of which side-by-side pictures are written."""


@dataclasses.dataclass(frozen=True, slots=True)
class Timed:
    """One picture with its wall time and the processor time of all threads, both in ms."""

    picture: Picture
    wall_ms: float
    cpu_ms: float


def timed(renderer: Renderer, view: AirwayView) -> Timed:
    """Render a view and return the picture with its times."""
    wall, cpu = time.perf_counter(), time.process_time()
    picture = renderer.render(view)
    return Timed(picture, 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu))


def renderers(case: Case) -> dict[str, tuple[Renderer, Renderer]]:
    """Return renderers with each appearance of the walls, on the CPU and on the first graphics adapter."""
    plain, decorated = shipped(case)
    tip_lit = Renderer(case.volume, transfer=dataclasses.replace(decorated.transfer, appearance=None))
    tip_lit.prepare()
    backend = Backend("gpu")
    pairs = {}
    for name, on_cpu in (("tip-lit", tip_lit), ("shipped", plain), ("decorated", decorated)):
        on_device = Renderer(case.volume, transfer=on_cpu.transfer, backend=backend)
        on_device.adopt_scene(on_cpu.scene)
        pairs[name] = (on_cpu, on_device)
    return pairs


def view_of(pose: Pose, size: tuple[int, int]) -> AirwayView:
    """Return the airway view of a pose as the window shows it, with the default instrument's lens."""
    return AirwayView.of_scope(scope_preset(DEFAULT_SCOPE), pose, width=size[0], height=size[1])


def beside(cpu: Picture, device: Picture) -> np.ndarray:
    """Return the CPU's and the device's picture side by side with a third one that marks pixels off by over a level."""
    off = np.abs(cpu.rgb.astype(np.int16) - device.rgb).max(axis=2) > 1
    return np.hstack([cpu.rgb, device.rgb, np.repeat((255 * off).astype(np.uint8)[..., None], 3, axis=2)])


def run(name: str, *, sizes: tuple[tuple[int, int], ...], output: Path | None) -> None:
    """Print the table of one case, and write its side-by-side pictures."""
    case = open_case(name, poses=NUM_POSES)
    print(f"{case.name}: {case.volume!r}, load {load_average()}", flush=True)
    poses = case.flight[:NUM_POSES]
    for look, (on_cpu, on_device) in renderers(case).items():
        for size in sizes:
            rows: dict[str, list[Timed]] = {"cpu": [], "device": []}
            parts = []
            for number, pose in enumerate(poses):
                view = view_of(pose, size)
                if number == 0:
                    # The first pictures of a size allocate buffers and compile pipelines.
                    timed(on_cpu, view)
                    timed(on_device, view)
                cpu, device = timed(on_cpu, view), timed(on_device, view)
                if not device.picture.stats.method.startswith("gpu-"):
                    raise SystemExit("the device rendered no picture: build with graphics support, see the docstring")
                rows["cpu"].append(cpu)
                rows["device"].append(device)
                parts.append(differing_share(cpu.picture.rgb, device.picture.rgb))
                if output is not None and number in PICTURED and size == SIZES[0]:
                    save(output, f"{case.name}-{look}-{number}", beside(cpu.picture, device.picture))
            wall, used = (
                {who: statistics.median(getattr(t, unit) for t in taken) for who, taken in rows.items()}
                for unit in ("wall_ms", "cpu_ms")
            )
            print(
                f"  {look:9} {size[0]:4} x {size[1]:4}: "
                f"CPU {wall['cpu']:7.1f} ms ({used['cpu']:.0f} of the processor), device {wall['device']:7.1f} ms "
                f"({used['device']:.0f}); off by more than a level: {max(parts):.1e}",
                flush=True,
            )


def main() -> None:
    """Run the benchmark of the graphics device for the cases that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=["phantom-256", "patient"], metavar="CASE")
    parser.add_argument("--quick", action="store_true", help="only pictures of 512 x 512")
    parser.add_argument("--output", type=Path, help="folder for side-by-side pictures")
    options = parser.parse_args()
    if options.output is not None:
        make_folder(options.output, what="the pictures")
    for name in options.cases:
        run(name, sizes=SIZES[:1] if options.quick else SIZES, output=options.output)


if __name__ == "__main__":
    main()
