"""The commands about the airway tree: find, export and track airways, and plan the way to a nodule."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.argument_checks import PATH_CHARACTERS
from carina.cli.arguments import parse_point
from carina.cli.console import exit_codes
from carina.cli.options import CtOption, JsonOption, PathArgument, SeriesOption, StrictOption

FromMaskOption = Annotated[
    Path | None,
    typer.Option(
        "--from-mask",
        help="Segmentation to use instead of the automatic one: NIfTI, NRRD, MetaImage or DICOM SEG.",
    ),
]
LabelOption = Annotated[int | None, typer.Option("--label", help="Label of the airway lumen in the segmentation.")]
ResampleOption = Annotated[
    bool, typer.Option("--resample", help="Resample the segmentation if its grid differs from that of the scan.")
]


def airways(
    path: PathArgument,
    seed: Annotated[
        str | None,
        typer.Option(
            "--seed",
            help=(
                "Point in the trachea, x,y,z in mm (LPS), if the trachea is not found automatically. The tree begins "
                "at the upper end of the trachea."
            ),
        ),
    ] = None,
    from_mask: FromMaskOption = None,
    label: LabelOption = None,
    resample: ResampleOption = False,
    mask: Annotated[
        Path | None,
        typer.Option(
            "--mask", help=("Lumen mask to write, up to the walls, on the scan's grid: .nii.gz, .nii, .nrrd or .mha.")
        ),
    ] = None,
    add_branch: Annotated[
        list[str] | None,
        typer.Option("--add-branch", help="Add a branch that ends at x,y,z in mm (LPS); may be given several times."),
    ] = None,
    even_without_evidence: Annotated[
        bool,
        typer.Option(
            "--even-without-evidence",
            help="Add branches even where the CT shows no airway; such branches are labelled as drawn by hand.",
        ),
    ] = False,
    series: SeriesOption = None,
    ct: CtOption = None,
    strict: StrictOption = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Airway tree file to write: .json.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the airway lumen and tree, with names, generations and lengths.

    A branch is not added where the CT shows no airway; the exit code is then 4, and the other results are still
    written.

    Example: carina airways ~/scans/thorax --mask lumen.nii.gz -o tree.json
    """
    with exit_codes(as_json):
        from carina.cli.airways import find

        raise SystemExit(
            find(
                path,
                seed=None if seed is None else parse_point(seed, "--seed"),
                from_mask=from_mask,
                label=label,
                resample=resample,
                series=series,
                ct=ct,
                mask=mask,
                output=output,
                as_json=as_json,
                strict=strict,
                add_lps=[parse_point(text, "--add-branch") for text in add_branch or ()],
                even_without_evidence=even_without_evidence,
            )
        )


def _list_formats(wanted: bool) -> None:
    if wanted:
        from carina.cli.airways import print_formats

        print_formats()
        raise typer.Exit


def export(
    path: PathArgument,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="File to write; its suffix selects the format (--formats lists all)."),
    ],
    tree: Annotated[
        Path | None, typer.Option("--tree", help="Airway tree file written by carina (default: segment the scan).")
    ] = None,
    from_mask: FromMaskOption = None,
    label: LabelOption = None,
    resample: ResampleOption = False,
    series: SeriesOption = None,
    ct: CtOption = None,
    strict: StrictOption = False,
    phantom_print: Annotated[
        bool,
        typer.Option(
            "--phantom-print",
            help="Write the airway wall as a solid for a 3D printer (.stl, .ply, .obj), open at the trachea.",
        ),
    ] = False,
    mould: Annotated[
        bool,
        typer.Option(
            "--mould",
            help="With --phantom-print: write a mould of the central airways: NAME-front, NAME-back, NAME-core.",
        ),
    ] = False,
    wall_mm: Annotated[
        float | None, typer.Option("--wall-mm", help="Thickness of the printed wall, 0.6 to 2.2 mm (default: 2).")
    ] = None,
    open_tips: Annotated[bool, typer.Option("--open-tips", help="Open the tips of the printed airways, too.")] = False,
    no_names: Annotated[bool, typer.Option("--no-names", help="Print without embossed names.")] = False,
    build_mm: Annotated[
        str | None, typer.Option("--build-mm", help="Build volume of the printer, x,y,z in mm (default: 250,210,210).")
    ] = None,
    least_wall_mm: Annotated[
        float | None, typer.Option("--least-wall-mm", help="Least wall that the printer makes, in mm (default: 1).")
    ] = None,
    as_json: JsonOption = False,
    formats: Annotated[
        bool, typer.Option("--formats", callback=_list_formats, is_eager=True, help="List the formats and exit.")
    ] = False,
) -> None:
    """Write the airways to a file for other software, in LPS millimetres.

    Example: carina export ~/scans/thorax -o airways.stl

    Example: carina export ~/scans/thorax -o phantom.stl --phantom-print --wall-mm 1.6
    """
    with exit_codes(as_json):
        from carina.cli.airways import PrintOptions, write

        raise SystemExit(
            write(
                path,
                printed=PrintOptions.of(
                    wanted=phantom_print,
                    mould=mould,
                    wall_mm=wall_mm,
                    open_tips=open_tips,
                    no_names=no_names,
                    build_mm=None if build_mm is None else parse_point(build_mm, "--build-mm"),
                    least_wall_mm=least_wall_mm,
                ),
                output=output,
                tree=tree,
                from_mask=from_mask,
                label=label,
                resample=resample,
                series=series,
                ct=ct,
                as_json=as_json,
                strict=strict,
            )
        )


def track(
    path: PathArgument,
    target: Annotated[
        list[str], typer.Option("--target", help=("Target point x,y,z in mm (LPS); may be given several times."))
    ],
    root_: Annotated[str, typer.Option("--root", help="Start point x,y,z in mm (LPS), or auto.")] = "auto",
    cost: Annotated[
        str,
        typer.Option(
            help=(
                "Cost function of the path search: lumen, walls (walls are costly, section 6.3 of the paper), or paper "
                "(section 6.2 of the paper as printed, where walls are cheap)."
            )
        ),
    ] = "lumen",
    graph: Annotated[
        str,
        typer.Option(
            help=(
                "Graph of the path search: voxel, or isoregion (section 6.1 of the paper: at most as many nodes, but "
                "two to three times as slow, and paths up to 25 % longer; figures in benchmarks/README.md)."
            )
        ),
    ] = "voxel",
    relax: Annotated[
        bool,
        typer.Option(
            "--relax/--no-relax",
            help=(
                "With --cost walls, shorten and smooth each path after the search, in the tube that the search "
                "followed; --no-relax writes the path of the search, as in the paper."
            ),
        ),
    ] = True,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Path tree file to write: .json.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the least-cost airway path from the start to each target (Intelligent Path Tracker, section 6 of the paper).

    A target outside the lumen is snapped to it if it is within 5 mm. If a target has no path, the exit code is 4; the
    other targets are still written. With --cost walls or paper, the search ignores the lumen, and any volume will do if
    --root is a point; each crossing of the wall of a segmented lumen is reported, and so are the values along the path.

    Example: carina track scan.nii.gz --root auto --target -41,12,-180 --target 38,20,-176 -o tree.json
    """
    with exit_codes(as_json):
        from carina.cli.track import report

        start = None if root_ == "auto" else parse_point(root_, "--root")
        targets = [parse_point(text, "--target") for text in target]
        raise SystemExit(
            report(
                path,
                root=start,
                targets=targets,
                cost=cost,
                graph=graph,
                relax=relax,
                series=series,
                strict=strict,
                ct=ct,
                output=output,
                as_json=as_json,
            )
        )


def plan(
    path: PathArgument,
    target: Annotated[
        str,
        typer.Option(
            "--target", help="Point in the nodule, x,y,z in mm (LPS), or a file: mask, DICOM SEG or RTSTRUCT."
        ),
    ],
    structure: Annotated[
        str | None, typer.Option("--structure", help="Name or number of the structure, where the file has several.")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option("--part", help="Point x,y,z in mm (LPS) in the part to take, where the structure has several."),
    ] = None,
    resample: Annotated[
        bool,
        typer.Option("--resample", help="Accept a target's mask or DICOM SEG on a different grid (nearest voxel)."),
    ] = False,
    scope: Annotated[
        str, typer.Option("--scope", help="Bronchoscope: ultrathin, thin, standard, ...; or a file (.json).")
    ] = "thin",
    tool: Annotated[
        str, typer.Option("--tool", help="Tool: needle-21g, needle-19g, forceps, ...; or a file (.json).")
    ] = "needle-21g",
    vessel_margin_mm: Annotated[
        float, typer.Option("--vessel-margin-mm", help="Vessels closer to the needle than this lower a route's score.")
    ] = 3.0,
    moved_mm: Annotated[
        float | None,
        typer.Option(
            "--moved-mm",
            help=("Distance the target may have moved since the CT (default: 20 mm in a lower lobe, 15 mm elsewhere)."),
        ),
    ] = None,
    second_ct: Annotated[
        Path | None,
        typer.Option(
            "--second-ct",
            help="CT of the same patient in another breath (DICOM folder, NIfTI or case) to measure the movement.",
        ),
    ] = None,
    carina_depth_mm: Annotated[
        float | None,
        typer.Option(
            "--carina-depth-mm",
            help="Length of the scope in the patient at nose or mouth when its tip is at the main carina.",
        ),
    ] = None,
    confirm: Annotated[
        str | None,
        typer.Option(
            "--confirm",
            help="Plan the target despite these doubts: codes separated by commas, such as target.tube, or all.",
        ),
    ] = None,
    compare: Annotated[
        list[str] | None,
        typer.Option("--compare", help="Another target, x,y,z in mm (LPS), to compare in one table; repeatable."),
    ] = None,
    all_scopes: Annotated[
        bool, typer.Option("--all-scopes", help="Judge every bronchoscope of the library on the best three routes.")
    ] = False,
    available: Annotated[
        str | None,
        typer.Option(
            "--available",
            help=(
                "Rank these bronchoscopes first, as with --all-scopes: names separated by commas, or all. Without this "
                "option those that the window has stored as available."
            ),
        ),
    ] = None,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Report: .html, .pdf, .json; or .mrk.json, .seg.nrrd, .seg.dcm, .sr.dcm, .pdf.dcm for other programs.",
        ),
    ] = None,
    only_tracing: Annotated[
        bool, typer.Option("--tracing-sheet", help="Write only the one-page tracing sheet (.html or .pdf).")
    ] = False,
    paper: Annotated[str, typer.Option("--paper", help="Paper of a PDF: A4 or Letter.")] = "A4",
    clips: Annotated[
        bool, typer.Option("--clips/--no-clips", help="In an .html report, the way to each fork as a short clip.")
    ] = True,
    with_identity: Annotated[
        bool,
        typer.Option("--with-identity", help="Copy the patient's name and number from the CT into DICOM files."),
    ] = False,
    send_to: Annotated[
        str | None,
        typer.Option("--send", help="Send the plan over OpenIGTLink to HOST:PORT, such as 3D Slicer on this machine."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan the route to a nodule outside the airways: the position of the scope's tip, and the needle's path from it.

    The boundary of the nodule is computed from the point. If no route reaches the nodule, the command prints the reason
    and exits with code 4. A target that may not be a nodule (a vessel, the mediastinum) is planned only with
    --confirm. Not a medical device.

    Example: carina plan scan.nii.gz --target -41,12,-180 --scope thin -o plan.html
    """
    with exit_codes(as_json):
        from carina.cli.plan import report

        is_file = target not in {".", ".."} and len(target) < PATH_CHARACTERS and Path(target).exists()
        raise SystemExit(
            report(
                path,
                target=Path(target) if is_file else parse_point(target, "--target"),
                structure=structure,
                part=None if part is None else parse_point(part, "--part"),
                resample=resample,
                scope=scope,
                tool=tool,
                vessel_margin_mm=vessel_margin_mm,
                moved_mm=moved_mm,
                second_ct=second_ct,
                carina_depth_mm=carina_depth_mm,
                confirm=confirm,
                all_scopes=all_scopes,
                available=available,
                compare=tuple(parse_point(point, "--compare") for point in compare or ()),
                series=series,
                strict=strict,
                ct=ct,
                output=output,
                kind="tracing" if only_tracing else "report",
                paper=paper,
                clips=clips,
                identity="from the CT" if with_identity else "none",
                send_to=send_to,
                as_json=as_json,
            )
        )
