"""De-identified copies of DICOM images: the basic application level confidentiality profile of PS3.15, annex E."""

from __future__ import annotations

from carina.deidentification.deidentify import DeidentifiedImages, deidentify

__all__ = ["DeidentifiedImages", "deidentify"]
