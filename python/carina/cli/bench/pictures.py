"""Pictures of a run, and how two of them differ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

__all__ = ["difference", "save"]


def save(folder: str | Path, name: str, rgb: NDArray[np.uint8]) -> str:
    """Write a PNG and return its name."""
    target = Path(folder) / f"{name}.png"
    sitk.WriteImage(sitk.GetImageFromArray(np.ascontiguousarray(rgb), isVector=rgb.ndim == 3), str(target))
    return target.name


def difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> dict[str, Any]:
    """Largest and mean difference in grey levels of 255, and the share of pixels that differ at all."""
    apart = np.abs(a.astype(np.int16) - b.astype(np.int16))
    pixels = apart.max(axis=-1) if apart.ndim == 3 else apart
    return {
        "max": int(apart.max()),
        "mean": round(float(apart.mean()), 4),
        "share_of_pixels": float((pixels > 0).mean()),
        "share_above_one": float((pixels > 1).mean()),
    }
