"""Frames per second of the airway view, brute force and leaping, beside VTK's CPU ray cast mapper in the same run.

Same volume, pose, step and transfer function; shading off for the comparison of pictures (VTK shades with one light
direction for the whole image, so shaded pictures differ by design). All figures of one row come from one process,
interleaved; quote ratios, not milliseconds. Run: ``make bench``, or ``python benchmarks/render.py --help``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
FOV_DEG = 90.0
STEP_VOX = 0.5


@dataclass(frozen=True)
class Figure:
    """Median and spread of one way to render one view."""

    name: str
    median_ms: float
    low_ms: float
    high_ms: float


def _measure(functions: dict[str, Any], repeats: int) -> tuple[list[Figure], dict[str, Any]]:
    """Time the functions in turn, A B C A B C, after one warm-up each; process CPU is what one thread compares."""
    import numpy as np

    pictures = {name: function() for name, function in functions.items()}
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            times[name].append(1000 * (time.perf_counter() - start))
    figures = [Figure(n, float(np.median(t)), min(t), max(t)) for n, t in times.items()]
    return figures, pictures


def _vtk_renderer(volume: Any, transfer: Any, pose: Any, size: int) -> Any:
    """VTK's fixed-point CPU mapper on the same scene: one thread, automatic sample distance off, shading off."""
    import numpy as np
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    spacing = np.array(volume.spacing_mm)
    # The volume stays axis-aligned for VTK; the camera moves into the grid's own frame instead.
    lps_from_grid = volume.lps_from_ijk.copy()
    lps_from_grid[:3, :3] /= spacing
    assert np.linalg.det(lps_from_grid[:3, :3]) > 0, "a mirrored grid would need a mirrored camera"
    grid_from_camera = np.linalg.inv(lps_from_grid) @ pose.lps_from_camera

    image = vtk.vtkImageData()
    nz, ny, nx = volume.shape_zyx
    image.SetDimensions(nx, ny, nz)
    image.SetSpacing(*spacing)
    # The mapper takes unsigned short scalars; the offset is in the transfer function as well.
    offset = int(volume.hu_zyx.min())
    values = (volume.hu_zyx.astype(np.int32) - offset).astype(np.uint16)
    scalars = numpy_to_vtk(values.ravel(), deep=True, array_type=vtk.VTK_UNSIGNED_SHORT)
    image.GetPointData().SetScalars(scalars)

    colour, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    for hu, red, green, blue, alpha in transfer.points:
        colour.AddRGBPoint(hu - offset, red, green, blue)
        opacity.AddPoint(hu - offset, alpha)
    properties = vtk.vtkVolumeProperty()
    properties.SetColor(colour)
    properties.SetScalarOpacity(opacity)
    properties.SetScalarOpacityUnitDistance(transfer.reference_mm)
    properties.SetInterpolationTypeToLinear()
    properties.ShadeOff()

    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.SetAutoAdjustSampleDistances(0)
    mapper.SetImageSampleDistance(1.0)
    step_mm = STEP_VOX * float(spacing.min())
    mapper.SetSampleDistance(step_mm)
    mapper.SetInteractiveSampleDistance(step_mm)
    mapper.SetNumberOfThreads(1)
    actor = vtk.vtkVolume()
    actor.SetMapper(mapper)
    actor.SetProperty(properties)

    renderer = vtk.vtkRenderer()
    renderer.SetBackground(0, 0, 0)
    renderer.AddVolume(actor)
    camera = renderer.GetActiveCamera()
    position, forward, down = grid_from_camera[:3, 3], grid_from_camera[:3, 2], grid_from_camera[:3, 1]
    camera.SetPosition(*position)
    camera.SetFocalPoint(*(position + forward))
    camera.SetViewUp(*(-down))
    camera.SetViewAngle(FOV_DEG)
    camera.SetClippingRange(0.01, 2000.0)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(size, size)
    window.AddRenderer(renderer)
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.SetInputBufferTypeToRGB()

    def render() -> None:
        # A moved camera would be a new picture; an unchanged one is not cached by this mapper, but say so to be sure.
        mapper.Modified()
        window.Render()

    def picture() -> Any:
        render()
        grab.Modified()
        grab.Update()
        out = grab.GetOutput()
        width, height, _ = out.GetDimensions()
        rgb = vtk_to_numpy(out.GetPointData().GetScalars()).reshape(height, width, 3)
        return np.ascontiguousarray(rgb[::-1])

    render.picture = picture  # type: ignore[attr-defined]
    render.keep = (window, grab, image)  # type: ignore[attr-defined]
    return render


def _poses(volume: Any) -> tuple[Any, list[Any], Any]:
    """A pose in the middle of the trachea looking down, a short flight towards a tip on the right, and the lumen."""
    import carina
    from carina.navigate import FlightPath

    airways = carina.find_airways(volume)
    tree = airways.tree
    tips = tree.tips()
    deepest = max(tips, key=lambda branch: (branch.points[-1][0] < 0, branch.generation))
    route = tree.route_to(deepest.id)
    path = FlightPath(route.points_lps)
    trachea = next(branch for branch in tree.branches if branch.parent is None)
    middle = 0.5 * FlightPath(trachea.points).length_mm
    flight = [path.pose_at(middle + (path.length_mm - middle) * step / 8) for step in range(8)]
    return path.pose_at(middle), flight, airways.lumen_zyx


def _save(name: str, rgb: Any) -> None:
    import numpy as np
    import SimpleITK as sitk

    RESULTS.mkdir(parents=True, exist_ok=True)
    sitk.WriteImage(sitk.GetImageFromArray(np.ascontiguousarray(rgb), isVector=True), str(RESULTS / f"{name}.png"))


def run_case(case: str, sizes: list[int], repeats: int, with_vtk: bool) -> list[dict[str, Any]]:
    """All rows of one case in this process (whatever number of threads it was started with)."""
    import numpy as np

    import carina
    from carina.phantom import demo_phantom
    from carina.render import AirwayView, Renderer, transfer_preset

    volume = demo_phantom().volume if case == "phantom" else carina.demo_patient()
    pose, flight, _ = _poses(volume)
    transfer = transfer_preset("endoscopic")
    renderer = Renderer(volume, transfer=transfer)
    renderer.prepare()
    rows: list[dict[str, Any]] = []
    for size in sizes:
        for shading in (False, True):

            def cast(method: str, at: Any = pose, size: int = size, shading: bool = shading) -> Any:
                view = AirwayView(
                    at,
                    fov_deg=FOV_DEG,
                    width=size,
                    height=size,
                    step_vox=STEP_VOX,
                    shading=shading,
                    method=method,
                )
                return renderer.render(view)

            functions: dict[str, Any] = {"brute": lambda c=cast: c("brute"), "leap": lambda c=cast: c("leap")}
            vtk_render = None
            if with_vtk and not shading:
                vtk_render = _vtk_renderer(volume, transfer, pose, size)
                functions["vtk"] = vtk_render
            figures, pictures = _measure(functions, repeats)
            ms = {figure.name: figure.median_ms for figure in figures}
            brute, leap = pictures["brute"], pictures["leap"]
            row: dict[str, Any] = {
                "case": case,
                "size": size,
                "shading": shading,
                "median_ms": {k: round(v, 2) for k, v in ms.items()},
                "range_ms": {f.name: [round(f.low_ms, 2), round(f.high_ms, 2)] for f in figures},
                "frames_per_s": {k: round(1000 / v, 1) for k, v in ms.items()},
                "leap_over_brute": round(ms["brute"] / ms["leap"], 2),
                "samples_per_ray": {
                    "brute": round(brute.stats.num_samples / brute.stats.num_rays, 1),
                    "leap": round(leap.stats.num_samples / leap.stats.num_rays, 1),
                },
                "leap_minus_brute_max": int(np.abs(leap.rgb.astype(int) - brute.rgb.astype(int)).max()),
            }
            _save(f"{case}-{size}-{'shaded' if shading else 'flat'}-leap", leap.rgb)
            if vtk_render is not None:
                peer = vtk_render.picture()
                row["leap_over_vtk"] = round(ms["vtk"] / ms["leap"], 2)
                row["brute_over_vtk"] = round(ms["vtk"] / ms["brute"], 2)
                difference = np.abs(peer.astype(int) - brute.rgb.astype(int))
                row["vtk_mean_difference"] = round(float(difference.mean()), 2)
                row["vtk_p99_difference"] = round(float(np.percentile(difference, 99)), 1)
                _save(f"{case}-{size}-flat-vtk", peer)
            if shading:
                ratios = []
                for at in flight:
                    flown, _ = _measure({m: lambda m=m, a=at: cast(m, a) for m in ("brute", "leap")}, 1)
                    ratios.append(flown[0].median_ms / flown[1].median_ms)
                row["leap_over_brute_flight_median"] = round(float(np.median(ratios)), 2)
            rows.append(row)
    return rows


def main() -> int:
    """Measure with one thread beside VTK, then with all threads, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", default=["phantom", "patient"], choices=["phantom", "patient"])
    parser.add_argument("--sizes", nargs="+", type=int, default=[256, 512])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--worker", choices=["one-thread", "all-threads"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        rows = []
        for case in arguments.cases:
            rows += run_case(case, arguments.sizes, arguments.repeats, with_vtk=arguments.worker == "one-thread")
        print(json.dumps(rows))
        return 0

    from carina.render import build_info

    if build_info()["profile"] != "release":
        sys.exit("benchmarks refuse a debug build: run `make setup`")
    common = ["--repeats", str(arguments.repeats), "--cases", *arguments.cases, "--sizes", *map(str, arguments.sizes)]
    report: dict[str, Any] = {"machine": platform.platform(), "cores": os.cpu_count(), "core": build_info()}
    for worker, threads in (("one-thread", "1"), ("all-threads", str(os.cpu_count()))):
        # The thread pool is made once per process, so each count gets its own.
        environment = {**os.environ, "RAYON_NUM_THREADS": threads}
        command = [sys.executable, __file__, "--worker", worker, *common]
        done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
        report[worker] = json.loads(done.stdout.strip().splitlines()[-1])
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / "render.json").write_text(json.dumps(report, indent=2), encoding="utf-8")

    print(f"{report['machine']}, {report['cores']} cores, {report['core']['simd']} kernels, release build")
    print(
        f"step {STEP_VOX} voxel, field of view {FOV_DEG:g} degrees; medians of {arguments.repeats}; frames per second"
    )
    for worker in ("one-thread", "all-threads"):
        print(f"\n{worker}:")
        for row in report[worker]:
            fps = "  ".join(f"{name} {value:7.1f}/s" for name, value in row["frames_per_s"].items())
            shade = "shaded" if row["shading"] else "flat  "
            line = (
                f"  {row['case']:8} {row['size']}x{row['size']} {shade} {fps}  leap/brute {row['leap_over_brute']:.2f}x"
            )
            if "leap_over_vtk" in row:
                line += (
                    f"  leap/VTK {row['leap_over_vtk']:.2f}x"
                    f"  difference to VTK: mean {row['vtk_mean_difference']}, 99 % below {row['vtk_p99_difference']}"
                )
            if "leap_over_brute_flight_median" in row:
                line += f"  (flight median {row['leap_over_brute_flight_median']:.2f}x)"
            print(line)
    print(f"\npictures and figures: {RESULTS.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
