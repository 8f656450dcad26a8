"""Synthetic chest CT with exact ground truth, for demos, tests, teaching and synthetic data."""

from carina.phantom.airway_lesions import LESIONS
from carina.phantom.chest import (
    GENERATOR_VERSION,
    VARIANTS,
    Phantom,
    demo_phantom,
    generate_phantom,
    lumen_distance_at,
    write_phantom,
)
from carina.phantom.mr_picture import generate_mr_phantom

__all__ = [
    "GENERATOR_VERSION",
    "LESIONS",
    "VARIANTS",
    "Phantom",
    "demo_phantom",
    "generate_mr_phantom",
    "generate_phantom",
    "lumen_distance_at",
    "write_phantom",
]
