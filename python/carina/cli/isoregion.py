"""``carina isoregion``: compute the isoregion map of a scan, or check the map in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, print_note, progress_printer
from carina.cli.opened import check_case_options, open_input
from carina.cli.render import chosen_transfer
from carina.errors import UsageError
from carina.render import TransferFunction, isoregion_labels, isoregion_note, open_isoregion_map
from carina.render.value_labels import EQUAL_BY, EqualBy, equal_by_name
from carina.volume import GRID_SUFFIXES, Volume, check_grid_fits, write_grid
from carina.volume.grid_headers import read_grid_header
from carina.volume.inserted_structures import file_mark
from carina.volume.isoregion_bundle import contains_map


def write(
    path: Path,
    *,
    output: Path | None,
    with_scan: bool,
    map_file: Path | None,
    transfer: str | None,
    equal_by: str,
    series: str | None,
    strict: bool,
    ct: Path | None,
    as_json: bool,
) -> int:
    """Compute the isoregion map of a scan and write it to a file, or check a map that was written earlier."""
    if (output is None) == (map_file is None):
        raise UsageError("choose one file: -o writes the map, --map reads a map that was written earlier")
    if output is not None:
        check_output_file(output, *((".nrrd",) if with_scan else GRID_SUFFIXES))
        if output.exists() and path.exists() and output.samefile(path) and not (with_scan and _is_bundle(path)):
            raise UsageError(f"{output.name} is the scan, which would be replaced; choose another file for -o")
    elif with_scan:
        raise UsageError("--with-scan writes a file; give its name with -o FILE.nrrd")
    comparison = _comparison(equal_by, transfer)
    chosen = chosen_transfer(transfer)
    check_case_options(path, ct)
    source = open_input(path, series=series, strict=strict, progress=progress_printer(), ct=ct)
    compared = "classes" if chosen is not None else equal_by_name(source.volume.hu_zyx, comparison)
    if map_file is not None:
        radii = open_isoregion_map(map_file, source.volume, chosen, equal_by=comparison)
        file, done = map_file, "is the map of this scan"
    else:
        assert output is not None
        what = compared if chosen is None else f"the transfer function {transfer}"
        radii = _write_map(output, source.volume, chosen, comparison, what, with_scan=with_scan)
        file, done = output, "scan and map written" if with_scan else "written"
        print_note(f"voxels were compared by {what}")
    share = float(np.count_nonzero(radii)) / radii.size
    largest = int(radii.max())
    print_note(f"{file}: {done}; {100.0 * share:.1f} % of the voxels have equal neighbours; largest radius {largest}")
    if as_json:
        print_json(
            {
                "file": str(file),
                "equal_by": compared,
                "share_with_equal_neighbours": share,
                "largest_radius": largest,
                "badges": source.badges.to_json(),
            }
        )
    return 0


def _is_bundle(path: Path) -> bool:
    """Return whether a file of a scan was written with its map; it can be written again without a loss."""
    return contains_map(read_grid_header(path, "nrrd"))


def _comparison(equal_by: str, transfer: str | None) -> EqualBy:
    """Return the value of ``--equal-by``, or raise an error if it is unknown or beside a transfer function."""
    if equal_by != "auto" and transfer is not None:
        raise UsageError("--equal-by compares values; omit it, or omit --transfer")
    if equal_by == "values":
        return "values"
    if equal_by == "bins":
        return "bins"
    if equal_by != "auto":
        raise UsageError(f"--equal-by: expected {', '.join(EQUAL_BY)}; found {equal_by}")
    return "auto"


def _write_map(
    output: Path, volume: Volume, chosen: TransferFunction | None, comparison: EqualBy, what: str, *, with_scan: bool
) -> NDArray[np.uint8]:
    """Compute the map and write it on the grid of the scan, with a note that identifies the scan and the labels.

    With ``with_scan`` the file is the scan, and its map precedes the voxels.
    """
    check_grid_fits(output, volume.shape_zyx, volume.lps_from_ijk, what="the IsoRegion map")
    radii = carina.isoregion_map(volume, chosen, equal_by=comparison)
    identity = isoregion_note(volume, isoregion_labels(volume, chosen, equal_by=comparison), radii)
    note = f"{identity} IsoRegion radii in voxels, equal by {what}; the cube of a voxel has 2 r + 1 voxels on each side"
    if with_scan:
        mark = file_mark(volume.source)
        note = note if mark is None else f"{note}; {mark}"
        write_grid(output, volume.hu_zyx, volume.lps_from_ijk, what="the scan", note=note, before=radii)
    else:
        write_grid(output, radii, volume.lps_from_ijk, what="the IsoRegion map", note=note)
    return radii
