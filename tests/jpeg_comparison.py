"""Writer of JPEG files, and a comparison of decoded JPEGs, for golden pictures of the documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import SimpleITK as sitk

JPEG_QUALITY = 88


def write_jpeg(rgb: np.ndarray, path: Path) -> None:
    """Write an RGB picture to a JPEG file."""
    writer = sitk.ImageFileWriter()
    writer.SetFileName(str(path))
    writer.UseCompressionOn()
    writer.SetCompressionLevel(JPEG_QUALITY)
    writer.Execute(sitk.GetImageFromArray(rgb, isVector=True))


def same(expected: np.ndarray, found: np.ndarray) -> bool:
    """Return whether two decoded JPEGs show one picture, with a tolerance for the rounding of encoders."""
    if expected.shape != found.shape:
        return False
    off = np.abs(expected.astype(int) - found).max(axis=2)
    return off.mean() <= 0.2 and (off <= 12).mean() >= 0.998
