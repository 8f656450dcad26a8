"""A plan with exact positions and without a CT, for tests of files that contain plans."""

from __future__ import annotations

import dataclasses

import numpy as np
from nodules import ellipsoid

from carina.plan import DistanceOrigin, Plan, TargetMovement, tool
from carina.plan.routes.last_leg import CrossedTissue, LastLeg
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.routes.route_width import RouteWidth
from carina.scopes import ScopeHold, scope_preset
from carina.track import AirwayTree, Branch

__all__ = ["DOUBT", "a_plan", "a_tree"]

DOUBT = "RB3b was drawn by hand"
AIM = (31.25, -17.5, -88.125)


def a_tree() -> AirwayTree:
    """Return a tree of a trachea, a left branch that bends forwards, and a right branch.

    No branch is parallel to an axis.
    """
    fork = np.array([1.5, 2.25, -40.0])
    down = np.linspace([-1.0, 4.0, 20.0], fork, 61)
    at = np.linspace(0.0, 1.0, 81)[:, None]
    left = fork + at * [26.0, -3.0, -42.0] + at**2 * [0.0, -14.0, 0.0]
    right = fork + at * [-30.0, 5.0, -38.0]
    return AirwayTree(
        (
            Branch(0, None, (4, 9), 0, "Trachea", "tracked", down, np.full(len(down), 8.0)),
            Branch(4, 0, (), 1, "LB3", "tracked", left, np.full(len(left), 2.5)),
            Branch(9, 0, (), 1, None, "manual", right, np.full(len(right), 2.0)),
        )
    )


def a_plan(*, doubts: tuple[str, ...] = (DOUBT,), aim_lps: tuple[float, float, float] = AIM) -> Plan:
    """Return a plan with two routes to one target: a certain one along branch 4 and a doubtful one along branch 9."""
    tree = a_tree()
    nodule = ellipsoid([6.0, 4.5, 5.0], aim_lps)
    return Plan(
        nodule=dataclasses.replace(nodule, touches=("pleura",)),
        scope=scope_preset("thin"),
        tool=tool("needle-21g"),
        bronchus_sign="beside",
        sign_branch="LB3",
        sign_lps=(28.0, -15.0, -82.0),
        movement=TargetMovement("default", 15.0),
        routes=(
            _route(tree, 4, 70, "LB3", nodule.centre_lps),
            _route(tree, 9, 33, "branch 9", nodule.centre_lps, doubts=doubts),
        ),
        why=None,
    )


def _route(
    tree: AirwayTree,
    branch_id: int,
    n: int,
    name: str,
    aim_lps: tuple[float, float, float],
    *,
    doubts: tuple[str, ...] = (),
) -> PlannedRoute:
    points = tree.branch(branch_id).points
    tip, aim = points[n], np.array(aim_lps)
    ahead = points[n] - points[n - 1]
    entry = tip + 0.2 * (aim - tip)
    far_mm = float(np.linalg.norm(aim - tip))
    leg = LastLeg(
        tip_lps=(float(tip[0]), float(tip[1]), float(tip[2])),
        aim_lps=aim_lps,
        entry_lps=(float(entry[0]), float(entry[1]), float(entry[2])),
        to_target_mm=far_mm - 5.0,
        outside_mm=far_mm - 7.0,
        angle_deg=35.0,
        crossed=(CrossedTissue("lumen", 0.0, 2.0), CrossedTissue("airway wall", 2.0, 1.5)),
        in_target_mm=7.5,
        least_in_target_mm=3.0,
        vessel_mm=None,
        vessel_lps=None,
        beyond_mm=None,
        hit_share=0.8,
        reaches=True,
        hit_share_moved=0.2,
    )
    unit = ahead / np.linalg.norm(ahead)
    return PlannedRoute(
        branch_id=branch_id,
        branch_name=name,
        along_mm=100.0,
        origin=DistanceOrigin("ridge", along_mm=57.0, axes_mm=48.0),
        forward=(float(unit[0]), float(unit[1]), float(unit[2])),
        hold=ScopeHold(120.0, 0.0, 0.5),
        width=RouteWidth(4.1, 0.3, 80.0),
        fit="does not fit",
        leg=leg,
        parts={},
        score=0.7,
        doubts=doubts,
    )
