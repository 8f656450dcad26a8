"""Check of a lumen from external software against the CT, branch by branch along the whole length."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from carina.track.intensity_levels import AirScale
from carina.track.paths.live_path import sampled
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Note, Volume

DOUBTED = "track.mask-doubted"
"""Code of the permanent note on a mask that does not match its CT."""

Points = NDArray[np.float64]

STEP_MM = 1.0
NUM_SIDES = 16
NUM_STEPS = 14
# Distance from the centreline, in radii, within which the middle of the lumen is measured.
MIDDLE = 0.35
# Distance in mm beyond a branch's radius up to which a wall is searched.
WALL_REACH_MM = 2.0
# Minimum rise from the lumen to a wall, in standard deviations of the noise and in HU.
RISE_SIGMA, MIN_RISE_HU = 4.0, 80.0
# Share of a section's sides with a visible wall, below which the section counts as without a wall.
MIN_WALLED = 0.6
# Value in HU (half-way between air and soft tissue) above which a voxel is not air.
AIR_HU = -500.0
# Minimum share of a branch's length with evidence; with less the branch is doubtful.
MIN_EVIDENCE = 0.4
# Maximum share of the mask's length in doubtful branches; with more the mask is doubtful.
MAX_DOUBTED = 0.2
# Maximum radius in mm of a judged branch: wide airways stay dark under a mask that is displaced by some mm.
MAX_RADIUS_MM = 7.0


def mask_evidence(volume: Volume, branches: tuple[Branch, ...], noise_hu: float, scale: AirScale) -> list[Points]:
    """Return for each branch the share of sides with a wall, (n,), at points 1 mm apart along the branch.

    The share is 0 where the middle of the lumen is not dark.
    """
    places, across_u, across_v, radii, counts = [], [], [], [], []
    for branch in branches:
        at, along, radius = _sampled_points(branch)
        helper = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        u = np.cross(along, helper)
        u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-9)
        places.append(at)
        across_u.append(u)
        across_v.append(np.cross(along, u))
        radii.append(radius)
        counts.append(len(at))
    at, u, v, radius = (np.concatenate(parts) for parts in (places, across_u, across_v, radii))
    angle = 2.0 * np.pi * np.arange(NUM_SIDES) / NUM_SIDES
    sides = np.cos(angle)[None, :, None] * u[:, None, :] + np.sin(angle)[None, :, None] * v[:, None, :]
    voxel_mm = float(np.prod(volume.spacing_mm)) ** (1 / 3)
    reach = radius + WALL_REACH_MM + voxel_mm
    off = np.linspace(0.0, 1.0, NUM_STEPS)[None, :] * reach[:, None]
    points = at[:, None, None, :] + sides[:, :, None, :] * off[:, None, :, None]
    values = sampled(volume, points.reshape(-1, 3)).reshape(points.shape[:3])
    is_middle = off <= np.maximum(MIDDLE * radius, 1e-6)[:, None]
    middle = (values.mean(axis=1) * is_middle).sum(axis=1) / is_middle.sum(axis=1)
    rise = values.max(axis=2) - middle[:, None]
    least = max(RISE_SIGMA * scale.span(noise_hu), scale.span(MIN_RISE_HU))
    with_wall = (rise > least).mean(axis=1)
    with_wall[middle > scale.level(AIR_HU)] = 0.0
    return list(np.split(with_wall, np.cumsum(counts)[:-1]))


def _sampled_points(branch: Branch) -> tuple[Points, Points, NDArray[np.float64]]:
    """Return points of a branch beyond the fork at its start, the unit direction there, and the radius in mm."""
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    first = min(float(branch.radius[0]), 0.5 * along[-1])
    last = max(along[-1] - min(STEP_MM, 0.2 * along[-1]), first)
    at = np.linspace(first, last, max(int((last - first) / STEP_MM) + 1, 2))

    def point_at(mm: NDArray[np.float64]) -> Points:
        return np.stack([np.interp(mm, along, branch.points[:, axis]) for axis in range(3)], axis=1)

    ahead = point_at(at + 1.5) - point_at(at - 1.5)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    ahead = np.where(length > 0.0, ahead / np.maximum(length, 1e-9), np.array([0.0, 0.0, 1.0]))
    return point_at(at), ahead, np.interp(at, along, branch.radius)


def with_mask_doubts(
    volume: Volume, tree: AirwayTree, noise_hu: float, scale: AirScale
) -> tuple[AirwayTree, Note | None]:
    """Return a mask's tree with confidences of its doubtful branches, and with a note if the mask is doubtful.

    The share of a branch is the part of its length with a dark middle and a wall on most sides: 1 if this is so
    along the whole branch, 0 for a branch in tissue or in lung without a wall. A mask drawn at the outer side of the
    walls matches as well. The share becomes the confidence of branches without enough evidence, and of all branches
    if the mask does not match.

    Parameters
    ----------
    volume
        The CT.
    tree
        The tree of the mask.
    noise_hu
        Standard deviation of the values in the widest airway, HU.
    scale
        Conversion from HU to the values of the volume.

    Returns
    -------
    AirwayTree, Note or None
        The tree, and the permanent note on a mask that does not match the CT.
    """
    found = mask_evidence(volume, tree.branches, noise_hu, scale)
    shares = [float((with_wall >= MIN_WALLED).mean()) for with_wall in found]
    doubts = [
        (branch.length_mm, share)
        for branch, share in zip(tree.branches, shares, strict=True)
        if float(np.median(branch.radius)) <= MAX_RADIUS_MM
    ]
    total_mm = sum(length for length, _ in doubts)
    doubted = [length for length, share in doubts if share < MIN_EVIDENCE]
    note = None
    if sum(doubted) > MAX_DOUBTED * total_mm:
        words = (
            f"the segmentation does not match this CT: {len(doubted)} of its {len(doubts)} smaller airways, "
            f"{100.0 * sum(doubted) / total_mm:.0f} % of their length, lie in tissue, or in lung without a wall "
            "around them. The segmentation may belong to another scan or patient, or be shifted or mirrored"
        )
        note = Note(DOUBTED, words, badge=True)
    branches = tuple(
        # A branch from another tool is accepted as it is if there is no evidence against it.
        dataclasses.replace(branch, confidence=round(share, 3)) if note is not None or share < MIN_EVIDENCE else branch
        for branch, share in zip(tree.branches, shares, strict=True)
    )
    return dataclasses.replace(tree, branches=branches), note


def unnamed_where_doubted(tree: AirwayTree) -> AirwayTree:
    """Return a tree in which the confidence of each name is at most that of its branch."""
    return dataclasses.replace(tree, branches=tuple(_with_branch_confidence(branch) for branch in tree.branches))


def _with_branch_confidence(branch: Branch) -> Branch:
    sure, name_sure = branch.confidence, branch.name_confidence
    if sure is None or name_sure is None or name_sure <= sure:
        return branch
    return dataclasses.replace(branch, name_confidence=sure)
