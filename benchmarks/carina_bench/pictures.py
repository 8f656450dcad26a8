"""PNG files of the pictures of a run, and measures of the difference between two pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.disk import write_whole
from carina.display.png import png_bytes

__all__ = ["difference", "save"]


def save(folder: str | Path, name: str, rgb: NDArray[np.uint8]) -> str:
    """Write a picture (height, width, 3), or a grey one (height, width), as PNG and return the name of the file."""
    colours = np.repeat(rgb[..., None], 3, axis=2) if rgb.ndim == 2 else rgb
    content = png_bytes(np.ascontiguousarray(colours))
    return write_whole(Path(folder) / f"{name}.png", content, what="the image").name


def difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> dict[str, Any]:
    """Return the largest and mean difference in grey levels (0 to 255), and the share of unequal pixels."""
    apart = np.abs(a.astype(np.int16) - b.astype(np.int16))
    pixels = apart.max(axis=-1) if apart.ndim == 3 else apart
    return {
        "max": int(apart.max()),
        "mean": round(float(apart.mean()), 4),
        "share_of_pixels": float((pixels > 0).mean()),
        "share_above_one": float((pixels > 1).mean()),
    }
