"""``carina render --view xray-set``: the three X-rays of a scan or a case side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, print_note, progress_printer
from carina.cli.opened import check_case_options, open_input
from carina.errors import UsageError
from carina.render import render_xray_set
from carina.volume.point_check import check_in_volume

XRAY_SET = "xray-set"
"""Name under which the command renders the three X-rays; the window shows them one by one."""


def write_xray_set(
    path: Path,
    *,
    output: Path,
    at: NDArray[np.float64] | None,
    size: tuple[int, int],
    window: tuple[float, float] | None,
    series: str | None,
    strict: bool,
    ct: Path | None,
    as_json: bool,
) -> int:
    """Render the three X-rays in one scale, mark the tip, and write one PNG."""
    check_output_file(output, ".png")
    if size[0] != size[1]:
        raise UsageError(f"--size: each X-ray of the set is square; found {size[0]}x{size[1]}")
    check_case_options(path, ct)
    source = open_input(path, series=series, strict=strict, progress=progress_printer(), ct=ct)
    if at is not None:
        check_in_volume(source.volume, at, "--at")
    elif source.tip is not None:
        at = source.tip.position_lps
    found = render_xray_set(source.volume, tip_lps=at, size=size[0], window_hu=window)
    found.save(output, badges=source.badges.notes)
    print_note(f"wrote {output}")
    if as_json:
        height, width = found.picture.rgb.shape[:2]
        print_json(
            {
                "file": str(output),
                "view": XRAY_SET,
                "size": [width, height],
                "mm_per_px": found.mm_per_px,
                "views": [part.view for part in found.parts],
                "badges": source.badges.to_json(),
            }
        )
    return 0
