"""State of a simulated scope in a moved patient: contact and red-out at the deformed wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestDeformation
from carina.scopes.drive import Contact, ScopeState
from carina.scopes.wall_field import WallField

SLOPE_MM = 0.5
"""Step in mm of the differences that give the direction of the nearest wall."""


def scope_in_moved_patient(
    state: ScopeState, wall: WallField, deformation: ChestDeformation, tip_mm: float
) -> ScopeState:
    """Return the state of a scope that the moved tissue has carried along.

    The pose is carried along. The tip also touches where the lumen has space for it at rest but not after the movement,
    and the red-out is that at the moved wall. The record of contacts and the controls remain those of the scope.

    Parameters
    ----------
    state
        State of a :class:`carina.ScopeDrive` in the wall at rest.
    wall
        The wall at rest.
    deformation
        Deformation of the chest; one that moves nothing returns the state itself.
    tip_mm
        Diameter of the tip, mm.
    """
    if deformation.is_rest:
        return state
    pose, moved = state.pose.carried_by(deformation), wall.deformed(deformation)
    at, radius_mm = pose.position_lps, tip_mm / 2.0
    red_out = _red_out(moved, at, radius_mm)
    if state.red_out == 0.0 and _red_out(wall, state.pose.position_lps, radius_mm) > 0.0:
        # At its entry the scope ignores the wall at the cut end of the trachea, so there is no red-out there.
        red_out = 0.0
    contact, space_mm = state.contact, float(moved.ball_mm(at)[0])
    if contact is not None:
        normal = np.linalg.solve(deformation.lps_from_rest[:3, :3].T, np.array(contact.normal_lps))
        contact = Contact(_point(deformation.points(contact.point_lps)[0]), _unit(normal), contact.depth_mm)
    elif space_mm < radius_mm <= float(wall.ball_mm(state.pose.position_lps)[0]):
        steps = SLOPE_MM * np.concatenate([np.eye(3), -np.eye(3)])
        away = moved.distance_mm(at + steps)
        normal = np.array(_unit(away[:3] - away[3:]))
        contact = Contact(_point(at - space_mm * normal), _point(normal), radius_mm - space_mm)
    return replace(state, pose=pose, contact=contact, red_out=max(red_out, state.red_out))


def _red_out(wall: WallField, at_lps: NDArray[np.float64], radius_mm: float) -> float:
    """Return the red-out as `ScopeState.red_out`."""
    return float(np.clip((0.6 * radius_mm - wall.distance_mm(at_lps)[0]) / (0.45 * radius_mm), 0.0, 1.0))


def _unit(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    return _point(vector / max(float(np.linalg.norm(vector)), 1e-12))


def _point(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
