"""``python -m carina_bench.printed_walls``: thickness and closure of the printed airway wall, over phantoms and a CT.

Both thicknesses are exact distances from vertices of the printed mesh to its triangles: from the outer surface to the
inner one, and from the inner surface to the outer one, where neighbouring airways share material and only the least
distance counts. Places near the cut end of the trachea are left out.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

import carina
from carina.export import PrintablePhantom, printable_phantom, write_mesh
from carina.export.printable_phantom import PrintedLumen
from carina.phantom import generate_phantom
from carina.track import Airways
from carina.volume import Volume

__all__ = ["WallThickness", "distances_to_triangles", "is_watertight", "wall_thickness"]

Floats = NDArray[np.float64]
END_MM = 25.0
"""Length in mm of the printed wall, from the beginning of the trachea, that is not measured."""
POINTS = 4000
REACH_MM = 4.0


@dataclass(frozen=True, slots=True)
class WallThickness:
    """Distances in mm between the surfaces of a printed wall."""

    outer: Floats
    """(n,) distances from places on the outer surface to the inner surface."""
    inner: Floats
    """(m,) distances from places on the inner surface to the outer surface."""


def wall_thickness(
    made: PrintablePhantom, volume: Volume, airways: Airways, *, points: int = POINTS, seed: int = 1
) -> WallThickness:
    """Measure the thickness of a printed wall that has closed tips and no embossed branch names."""
    vertices, triangles = made.mesh.vertices_lps, made.mesh.triangles
    far = np.linalg.norm(vertices - airways.tree.root.points[0], axis=1) > END_MM
    # The distance to the lumen only decides on which surface a vertex is.
    field = PrintedLumen.of(volume, airways, None).field
    inner = -field.distance_mm(vertices) < 0.5 * made.wall_mm
    rng = np.random.default_rng(seed)
    found = []
    for side in (~inner, inner):
        (places,) = np.nonzero(side & far)
        places = places[rng.permutation(len(places))[:points]]
        # Triangles with a vertex on each surface are excluded: they exist only at the cut end of the trachea.
        other = triangles[(~side)[triangles].all(axis=1)]
        found.append(distances_to_triangles(vertices[places], vertices[other]))
    return WallThickness(found[0], found[1])


def is_watertight(made: PrintablePhantom) -> bool:
    """Return whether trimesh finds the STL of a phantom watertight, with consistent triangles and a positive volume."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_mesh(Path(folder) / "phantom.stl", made.mesh, contents="printable airway wall")
        found: Any = trimesh.load(path)
    return bool(found.is_watertight and found.is_winding_consistent and found.volume > 0.0)


def distances_to_triangles(points: Floats, corners: Floats, *, reach_mm: float = REACH_MM) -> Floats:
    """Return the exact distances (n,) of points (n, 3) to the nearest of the triangles (m, 3, 3), at most the reach."""
    found = np.full(len(points), reach_mm)
    middles = corners.mean(axis=1)
    order = np.argsort(middles[:, 2])
    heights = middles[order, 2]
    for number, point in enumerate(points):
        first, last = np.searchsorted(heights, [point[2] - reach_mm, point[2] + reach_mm])
        some = order[first:last]
        some = some[np.abs(middles[some] - point).max(axis=1) < reach_mm]
        if len(some):
            found[number] = min(reach_mm, float(_to_triangles(point, corners[some]).min()))
    return found


def _to_triangles(point: Floats, corners: Floats) -> Floats:
    """Return the distances (m,) of a point to triangles (m, 3, 3): to the plane if its foot is inside, else an edge."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    long = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    height = np.einsum("na,na->n", point - a, normal) / long
    inside = np.ones(len(corners), dtype=bool)
    edges = np.full(len(corners), np.inf)
    for one, other in ((a, b), (b, c), (c, a)):
        side = other - one
        inside &= np.einsum("na,na->n", np.cross(side, point - one), normal) >= 0.0
        share = np.einsum("na,na->n", point - one, side) / np.maximum(np.einsum("na,na->n", side, side), 1e-18)
        foot = one + np.clip(share, 0.0, 1.0)[:, None] * side
        edges = np.minimum(edges, np.linalg.norm(point - foot, axis=1))
    return np.where(inside, np.abs(height), edges)


def main(arguments: list[str] | None = None) -> int:
    """Print the thickness of the wall of each case."""
    parser = argparse.ArgumentParser(prog="python -m carina_bench.printed_walls", description=__doc__)
    parser.add_argument("--phantoms", type=int, default=5, help="number of phantoms, by seed from 1")
    parser.add_argument("--wall-mm", type=float, default=2.0)
    parser.add_argument("--points", type=int, default=POINTS, help="number of places on each surface")
    options = parser.parse_args(arguments)
    cases: list[tuple[str, Volume]] = [("bundled CT", carina.demo_patient())]
    cases += [(f"phantom {seed}", generate_phantom(seed=seed, spacing_mm=1.1, noise_hu=25.0, progress=False).volume)
              for seed in range(1, options.phantoms + 1)]  # fmt: skip
    for name, volume in cases:
        airways = carina.find_airways(volume, progress=False)
        made, whole = (
            printable_phantom(volume, airways, wall_mm=options.wall_mm, names=full, open_tips=full,
                              build_mm=(500.0, 500.0, 500.0), progress=False)
            for full in (False, True)
        )  # fmt: skip
        found = wall_thickness(made, volume, airways, points=options.points)
        low, middle, high = np.quantile(found.outer, (0.005, 0.5, 0.995))
        print(
            f"{name:12} {len(made.mesh.triangles)} triangles; outer to inner surface: {found.outer.min():.2f} to "
            f"{found.outer.max():.2f} mm ({low:.2f}, {middle:.2f}, {high:.2f}), {_share(found.outer, options.wall_mm)} "
            f"within 0.2 mm; inner to outer: least {found.inner.min():.2f} mm; watertight: "
            f"{is_watertight(made)}, with names and open tips {is_watertight(whole)}",
            flush=True,
        )
    return 0


def _share(found: Floats, wall_mm: float) -> str:
    return f"{int((np.abs(found - wall_mm) <= 0.2).sum())} of {len(found)}"


if __name__ == "__main__":
    raise SystemExit(main())
