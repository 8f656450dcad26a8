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
from carina.volume import GRID_SUFFIXES, Volume, check_grid_fits, write_grid


def write(
    path: Path,
    *,
    output: Path | None,
    map_file: Path | None,
    transfer: str | None,
    series: str | None,
    ct: Path | None,
    as_json: bool,
) -> int:
    """Compute the isoregion map of a scan and write it to a file, or check a map that was written earlier."""
    if (output is None) == (map_file is None):
        raise UsageError("choose one file: -o writes the map, --map reads a map that was written earlier")
    if output is not None:
        check_output_file(output, *GRID_SUFFIXES)
    chosen = chosen_transfer(transfer)
    check_case_options(path, ct)
    source = open_input(path, series=series, progress=progress_printer(), ct=ct)
    if map_file is not None:
        radii = open_isoregion_map(map_file, source.volume, chosen)
        file, done = map_file, "is the map of this scan"
    else:
        assert output is not None
        radii = _write_map(output, source.volume, transfer, chosen)
        file, done = output, "written"
    share = float(np.count_nonzero(radii)) / radii.size
    largest = int(radii.max())
    print_note(f"{file}: {done}; {100.0 * share:.1f} % of the voxels have equal neighbours; largest radius {largest}")
    if as_json:
        print_json(
            {
                "file": str(file),
                "equal_by": "values" if transfer is None else "classes",
                "share_with_equal_neighbours": share,
                "largest_radius": largest,
                "badges": source.badges.to_json(),
            }
        )
    return 0


def _write_map(
    output: Path, volume: Volume, transfer: str | None, chosen: TransferFunction | None
) -> NDArray[np.uint8]:
    """Compute the map and write it on the grid of the scan, with a note that identifies the scan and the labels."""
    check_grid_fits(output, volume.shape_zyx, volume.lps_from_ijk, what="the IsoRegion map")
    radii = carina.isoregion_map(volume, chosen)
    what = "16 HU" if transfer is None else f"the transfer function {transfer}"
    identity = isoregion_note(volume, isoregion_labels(volume, chosen), radii)
    note = f"{identity} IsoRegion radii in voxels, equal by {what}; the cube of a voxel has 2 r + 1 voxels on each side"
    write_grid(output, radii, volume.lps_from_ijk, what="the IsoRegion map", note=note)
    return radii
