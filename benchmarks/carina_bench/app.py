"""Command-line interface of ``carina bench``: one command for each benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.arguments import check_output_folder, parse_size
from carina.cli.console import exit_codes
from carina.cli.options import JsonOption

__all__ = ["bench"]

bench = typer.Typer(
    help="Figures beside installed peers (VTK, numba, scipy, dijkstra3d), in the same run; render, isoregion and "
    "track need the extra `bench`.",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
)

BenchFolder = Annotated[Path, typer.Option("-o", "--output", help="Folder for the pictures; made if missing.")]
BenchCases = Annotated[
    list[str] | None,
    typer.Option("--case", help="phantom-256, phantom-512, patient, or a CT's path; may be given several times."),
]
BenchOnly = Annotated[list[str] | None, typer.Option("--only", help="Only this section; may be given several times.")]
BenchQuick = Annotated[bool, typer.Option("--quick", help="A minute or two: small cases, fewer poses and repeats.")]
BenchRepeats = Annotated[int | None, typer.Option("--repeats", help="Rounds (default: 7).", min=1, max=1000)]


def _bench(
    what: str,
    output: Path,
    case: list[str] | None,
    only: list[str] | None,
    quick: bool,
    repeats: int | None,
    as_json: bool,
) -> None:
    with exit_codes(as_json):
        from carina_bench.command import report

        check_output_folder(output)
        code = report(
            what, folder=output, cases=case or [], only=only or [], quick=quick, repeats=repeats, as_json=as_json
        )
        raise SystemExit(code)


@bench.command("render")
def bench_render(
    output: BenchFolder = Path("carina-bench"),
    case: BenchCases = None,
    only: BenchOnly = None,
    quick: BenchQuick = False,
    repeats: BenchRepeats = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the times of whole frames with VTK and numba, and of empty-space skipping with brute force.

    Sections: frames, small, views, first-frame (time to the first frame), paper (the paper's setting). The section
    paper and the one real case need CARINA_DATA_DIR. A missed limit is reported; the exit code is still 0.

    Example: carina bench render --quick --only frames --case patient
    """
    _bench("render", output, case, only, quick, repeats, as_json)


@bench.command("isoregion")
def bench_isoregion(
    output: BenchFolder = Path("carina-bench"),
    case: BenchCases = None,
    only: BenchOnly = None,
    quick: BenchQuick = False,
    repeats: BenchRepeats = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the IsoRegion map, projections and oblique slices of a large CT, and the server's memory.

    Carina is compared with scipy, numpy and VTK. Sections: map, prepare, projections, plane, memory. A missed limit is
    reported and is no failure: the exit code is 0.

    Example: carina bench isoregion --only map --json
    """
    _bench("isoregion", output, case, only, quick, repeats, as_json)


@bench.command("track")
def bench_track(
    output: BenchFolder = Path("carina-bench"),
    only: BenchOnly = None,
    case: Annotated[
        list[str] | None,
        typer.Option(
            "--case",
            help="With one --only: a case of that part, such as phantom-24 (evidence), 2.5mm (hard) or tubes "
            "(statements); a wrong one lists them all. May be given several times.",
        ),
    ] = None,
    quick: BenchQuick = False,
    as_json: JsonOption = False,
) -> None:
    """Compare the path tracker with other programs, and the airway tree with the true airways.

    Parts: speed, paper, graphs, mr, quality, visible, names, measures, evidence. The parts walls, hard, shares,
    classes, statements, diameters, tips, gate and tilt take up to an hour or more each, so they run only if --only
    names them. The report names each part that was omitted because this version does not have it, or because its
    data or a program for comparison are missing. A missed limit is reported; the exit code is still 0.

    Example: carina bench track --only speed --quick
    """
    with exit_codes(as_json):
        from carina_bench.track import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, only=only or [], cases=case or [], quick=quick, as_json=as_json))


@bench.command("movement")
def bench_movement(
    output: BenchFolder = Path("carina-bench"),
    case: Annotated[
        list[str] | None,
        typer.Option("--case", help="phantom-N or a CT's folder; may be given several times."),
    ] = None,
    refusals: Annotated[
        bool, typer.Option("--refusals/--no-refusals", help="Also CTs that must be refused, such as another patient's.")
    ] = True,
    quick: BenchQuick = False,
    as_json: JsonOption = False,
) -> None:
    """Compare the movement of targets measured from a second CT with a known deformation.

    Ten phantoms and the real CT of CARINA_DATA_DIR are deformed by published amplitudes of breathing. Needs no extra;
    takes several minutes for each case. A missed limit is reported; the exit code is still 0.

    Example: carina bench movement --case phantom-7
    """
    with exit_codes(as_json):
        from carina_bench.plan_movement import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, cases=case or [], refusals=refusals, quick=quick, as_json=as_json))


@bench.command("open")
def bench_open(
    output: BenchFolder = Path("carina-bench"), quick: BenchQuick = False, as_json: JsonOption = False
) -> None:
    """Measure the time to open a CT of 512x512x600 from DICOM, from NIfTI, and from the cache, alternately.

    Needs no extra. A missed limit is reported; the exit code is still 0.

    Example: carina bench open --quick
    """
    with exit_codes(as_json):
        from carina_bench.opening import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, quick=quick, as_json=as_json))


@bench.command("reopen")
def bench_reopen(
    output: BenchFolder = Path("carina-bench"),
    case: Annotated[str | None, typer.Option("--case", help="A CT's path; else a synthetic chest.")] = None,
    quick: BenchQuick = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the time from the click on a saved case of 512x512x600 until its state and its first pictures arrive.

    The case is opened in a running Carina without a browser: from a disk cache that is in memory, and from one that
    must be read from the disk. Needs no extra. A missed limit is reported; the exit code is still 0.

    Example: carina bench reopen --quick
    """
    with exit_codes(as_json):
        from carina_bench.reopening import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, ct=case, quick=quick, as_json=as_json))


@bench.command("saving")
def bench_saving(
    output: BenchFolder = Path("carina-bench"), quick: BenchQuick = False, as_json: JsonOption = False
) -> None:
    """Measure how much saving delays the pictures of a flight at 30 pictures and four edits a second.

    The same flight runs with and without saving. Needs no extra and a machine without other load. A missed limit is
    reported and is no failure: the exit code is 0.

    Example: carina bench saving --quick
    """
    with exit_codes(as_json):
        from carina_bench.saving import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, quick=quick, as_json=as_json))


@bench.command("stream")
def bench_stream(
    output: BenchFolder = Path("carina-bench"),
    case: Annotated[str, typer.Option("--case", help="phantom, patient, or a CT's path.")] = "phantom",
    size: Annotated[str, typer.Option("--size", help="Size of the picture at rest, pixels.")] = "512x512",
    quick: BenchQuick = False,
    as_json: JsonOption = False,
) -> None:
    """Measure the time from an input to the decoded picture that shows it, for keys and for a device.

    CARINA_BACKEND selects the processor of the server's pictures. A missed limit is reported; the exit code is still 0.

    Example: carina bench stream --quick
    """
    with exit_codes(as_json):
        from carina_bench.stream import report

        check_output_folder(output)
        pixels = parse_size(size)
        raise SystemExit(report(folder=output, case=case, size=pixels, quick=quick, as_json=as_json))


@bench.command("cluster")
def bench_cluster(
    output: BenchFolder = Path("carina-bench"),
    only: BenchOnly = None,
    quick: BenchQuick = False,
    as_json: JsonOption = False,
) -> None:
    """Measure rendering on several machines: the paper's Tables 1 and 2, simulated and real, and the cost of Ray.

    Sections: network, simulation, sleeping, real, transport, kills. All but the first two need the extra `cluster`.
    Each section is printed when it ends. A section that fails is reported in its position of the output, and the other
    sections still run. Plots like Figures 9, 10 and 11 of the paper are written to the folder.

    Example: carina bench cluster --only simulation
    """
    with exit_codes(as_json):
        from carina_bench.cluster import report

        check_output_folder(output)
        raise SystemExit(report(folder=output, only=only or [], quick=quick, as_json=as_json))
