"""Pictures of paths in LIDC2 and headsq over their volume rendering, as in figure 14 of the paper.

``python -m carina_bench.tracked_in_3d FOLDER`` writes them; CARINA_DATA_DIR names the folder of the volumes. They are
shown in ``docs/gallery.md``.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.render import AirwayView, Light, Picture, Renderer, TransferFunction, letter_edges
from carina.scopes import Pose
from carina.track import TrackResult
from carina.volume import Volume
from carina_bench.paper import FOLDER

__all__ = ["SCENES", "Scene", "pictures_of", "tracked"]

Voxel = tuple[float, float, float]
Vector = NDArray[np.float64]

WIDTH, HEIGHT = 320, 360
"""Width and height in pixels of the compared pictures."""
FOV_DEG = 20.0
LIGHT = Light(ambient=0.4, diffuse=0.7)
PATH_RGB, ROOT_RGB, TARGET_RGB = (60, 220, 255), (255, 255, 255), (255, 220, 60)


@dataclasses.dataclass(frozen=True)
class Scene:
    """Volume with root and targets of its paths, and the cameras of its pictures."""

    file: str
    root_ijk: Voxel
    targets_ijk: dict[str, Voxel]
    """Targets by name, voxels that were read from the slices by eye."""
    points: tuple[tuple[float, ...], ...]
    """Points of the transfer function: value, red, green, blue and opacity per mm."""
    views: dict[str, Voxel]
    """Direction from the volume to the camera by the name of the picture, along the axes of the voxels."""
    up_ijk: Voxel
    """Upward direction of the pictures, along the axes of the voxels."""
    centre_ijk: Voxel
    distance_mm: float
    has_letters: bool
    """Whether the file states the position of the patient, so that letters at the edges are right."""


SCENES = {
    # The window of this CT shows air, lung and fat as 0, so its airways have no wall; its arteries contain contrast
    # medium.
    "lidc2": Scene(
        file="LIDC2_256x256x133_uint8.mha",
        root_ijk=(130, 120, 32),
        targets_ijk={
            "ascending aorta": (117, 148, 40),
            "brachiocephalic trunk": (117, 148, 28),
            "left subclavian artery": (129, 128, 20),
            "coeliac trunk": (146, 132, 100),
            "abdominal aorta": (142, 133, 116),
        },
        points=(
            (60, 0.8, 0.3, 0.25, 0.0),
            (90, 0.85, 0.3, 0.25, 0.02),
            (140, 0.9, 0.4, 0.3, 0.05),
            (170, 1.0, 0.95, 0.85, 0.06),
            (255, 1.0, 1.0, 0.95, 0.15),
        ),
        views={"front": (0.0, 1.0, 0.0), "left-oblique": (0.75, 0.66, 0.0)},
        up_ijk=(0.0, 0.0, -1.0),
        centre_ijk=(130, 132, 68),
        distance_mm=900.0,
        has_letters=True,
    ),
    "headsq": Scene(
        file="headsq_64x64x93_int16.mha",
        root_ijk=(28, 34, 36),
        targets_ijk={
            "nose": (31, 46, 36),
            "one maxillary sinus": (39, 43, 32),
            "other maxillary sinus": (22, 42, 30),
            "lower pharynx": (28, 35, 62),
        },
        points=(
            (300, 0.9, 0.75, 0.65, 0.0),
            (700, 0.9, 0.7, 0.6, 0.003),
            (1000, 0.9, 0.7, 0.6, 0.003),
            (1250, 1.0, 0.95, 0.85, 0.004),
            (2000, 1.0, 1.0, 0.95, 0.06),
            (3900, 1.0, 1.0, 1.0, 0.2),
        ),
        views={"side": (1.0, 0.25, 0.0), "oblique": (0.5, 1.0, 0.0)},
        # The slices of the file run from the top of the head downwards, although its header states the opposite.
        up_ijk=(0.0, 0.0, -1.0),
        centre_ijk=(30, 33, 46),
        distance_mm=580.0,
        has_letters=False,
    ),
}


def tracked(scene: Scene, volume: Volume) -> TrackResult:
    """Return the paths from the root of a scene to its targets, by the cost ``walls`` (paper 6.3)."""
    root, *targets = (
        volume.to_lps(np.array(ijk, dtype=np.float64)) for ijk in (scene.root_ijk, *scene.targets_ijk.values())
    )
    return carina.track_paths(volume, root=root, targets=targets, cost="walls", progress=False)


def pictures_of(scene: Scene, volume: Volume, paths: Sequence[Vector]) -> dict[str, Picture]:
    """Return the pictures of a scene by name, with its paths (n, 3), LPS mm, drawn over the volume."""
    transfer = TransferFunction(points=np.array(scene.points), unit="raw", name="tracked", light=LIGHT)
    renderer = Renderer(volume, transfer=transfer)
    lps_from_step = volume.lps_from_ijk[:3, :3] / np.linalg.norm(volume.lps_from_ijk[:3, :3], axis=0)
    centre = volume.to_lps(np.array(scene.centre_ijk, dtype=np.float64))
    made = {}
    for name, away_ijk in scene.views.items():
        away = lps_from_step @ np.array(away_ijk)
        away /= np.linalg.norm(away)
        pose = Pose.looking(centre + scene.distance_mm * away, -away, lps_from_step @ np.array(scene.up_ijk))
        picture = with_paths(renderer.render(AirwayView(pose, fov_deg=FOV_DEG, width=WIDTH, height=HEIGHT)), paths)
        made[name] = letter_edges(picture) if scene.has_letters else picture
    return made


def with_paths(picture: Picture, paths: Sequence[Vector]) -> Picture:
    """Return a copy of a picture with paths, their common root and their targets drawn over it."""
    rgb = picture.rgb.copy()
    rows, columns = np.mgrid[: rgb.shape[0], : rgb.shape[1]] + 0.5

    def dot(point: Vector, radius_px: float, colour: tuple[int, int, int]) -> None:
        at = picture.pixel_of(point)
        if at is not None:
            rgb[np.hypot(columns - at[0], rows - at[1]) <= radius_px] = colour

    # A dark border separates each line from the bright bone behind it.
    for radius_px, colour in ((2.6, (0, 0, 0)), (1.6, PATH_RGB)):
        for path in paths:
            for start, end in itertools.pairwise(path):
                for part in (0.0, 0.5):
                    dot(start + part * (end - start), radius_px, colour)
    for point, colour in [*((path[-1], TARGET_RGB) for path in paths), (paths[0][0], ROOT_RGB)]:
        dot(point, 5.0, (0, 0, 0))
        dot(point, 4.0, colour)
    return dataclasses.replace(picture, rgb=rgb)


def main() -> None:
    """Write the pictures of all scenes to a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Folder for the pictures.")
    folder = parser.parse_args().folder
    data = Path(os.environ["CARINA_DATA_DIR"]) / FOLDER
    for scene_name, scene in SCENES.items():
        volume = carina.open_volume(data / scene.file)
        result = tracked(scene, volume)
        paths = [target.path.points_lps for target in result.targets if target.path is not None]
        for name, picture in pictures_of(scene, volume, paths).items():
            print(picture.save(folder / f"{scene_name}-{name}.png"))


if __name__ == "__main__":
    main()
