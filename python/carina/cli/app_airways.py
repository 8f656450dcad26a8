"""The verbs about the airway tree: find it, write it, track paths in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.arguments import parse_point
from carina.cli.console import exit_codes
from carina.cli.options import CtOption, JsonOption, PathArgument, SeriesOption

__all__ = ["airways", "export", "track"]

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

StrictOption = Annotated[
    bool, typer.Option("--strict", help="Stop with exit code 3 if the check of the scan finds problems.")
]


def airways(
    path: PathArgument,
    seed: Annotated[
        str | None,
        typer.Option("--seed", help=("Point in the trachea, x,y,z in mm (LPS), if it is not found automatically.")),
    ] = None,
    from_mask: FromMaskOption = None,
    label: LabelOption = None,
    resample: ResampleOption = False,
    mask: Annotated[
        Path | None,
        typer.Option("--mask", help=("Lumen mask to write, on the scan's grid: .nii.gz, .nii, .nrrd or .mha.")),
    ] = None,
    add_branch: Annotated[
        list[str] | None,
        typer.Option("--add-branch", help="Add a branch that ends at x,y,z in mm (LPS); may be given several times."),
    ] = None,
    even_without_evidence: Annotated[
        bool,
        typer.Option(
            "--even-without-evidence",
            help="Draw added branches even where the CT shows no airway wall; they are labelled as drawn by hand.",
        ),
    ] = False,
    series: SeriesOption = None,
    ct: CtOption = None,
    strict: StrictOption = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Airway tree file to write: .json.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Airway lumen and tree, with names, generations and lengths.

    A branch that is to be added where the CT shows no wall along its way is not: exit code 4, and the other results are
    still written.

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
        typer.Option("-o", "--output", help="File to write. Its suffix sets the format; --formats lists them."),
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
    as_json: JsonOption = False,
    formats: Annotated[
        bool, typer.Option("--formats", callback=_list_formats, is_eager=True, help="List the formats and exit.")
    ] = False,
) -> None:
    """The airways as a file for another program, in LPS millimetres.

    Example: carina export ~/scans/thorax -o airways.stl
    """
    with exit_codes(as_json):
        from carina.cli.airways import write

        raise SystemExit(
            write(
                path,
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
        str, typer.Option(help=("Cost function of the path search: lumen, or paper (section 6.2 of the paper)."))
    ] = "lumen",
    graph: Annotated[
        str, typer.Option(help=("Graph of the path search: voxel, or isoregion (section 6.1 of the paper)."))
    ] = "voxel",
    series: SeriesOption = None,
    ct: CtOption = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Path tree file to write.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Least-cost airway paths from the root to each target (the Intelligent Path Tracker, paper 6).

    A target outside the lumen is snapped to it when within 5 mm; a target without a path is exit code 4, and the other
    targets are still written. With --cost paper every voxel can be walked on: what of a path lies outside the lumen is
    reported.

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
                series=series,
                ct=ct,
                output=output,
                as_json=as_json,
            )
        )
