"""Flight of the camera along a simulated drive: times and poses for recordings and videos."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError, check_type
from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation
from carina.plan.verdict.drive import DrivenRoute
from carina.scopes import Pose

RATES_HZ = (1.0, 120.0)


def drive_flight(driven: DrivenRoute, *, rate_hz: float = 25.0) -> tuple[NDArray[np.float64], tuple[Pose, ...]]:
    """Return the camera poses during a drive at a regular rate.

    A drive contains the state after each turn, each setting of the lever and each millimetre. The result contains
    all of these poses, and interpolated ones between them.

    Parameters
    ----------
    driven
        Drive of a verdict.
    rate_hz
        Least number of poses per second, 1 to 120.

    Returns
    -------
    times_s, poses
        (n,) ascending times from 0, and n camera poses.

    Raises
    ------
    UsageError
        If the rate is out of range.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import carina
    >>> from carina.plan import drive_flight, judge_scope, plan_route
    >>> from carina.scopes import scope_preset
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> airways = carina.find_airways(made.volume)
    >>> plan = plan_route(made.volume, airways, made.truth["nodule"]["centre_lps"])
    >>> wall = carina.wall_field(made.volume, airways)
    >>> own = replace(scope_preset("ultrathin"), tip_mm=1.8, tube_mm=1.8)
    >>> verdict = judge_scope(airways.tree, plan, wall, own, effort=4000.0)
    >>> times_s, poses = drive_flight(verdict.driven)
    >>> len(times_s) == len(poses)
    True
    """
    check_type("drive_flight", "driven", driven, DrivenRoute, "it is the drive of a verdict: Verdict.driven")
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise UsageError(f"rate_hz: expected {RATES_HZ[0]:g} to {RATES_HZ[1]:g}; found {rate_hz}", code="plan.range")
    times, poses = [0.0], [driven.lps_from_camera[0]]
    for n in range(1, len(driven.time_s)):
        before, after = driven.lps_from_camera[n - 1], driven.lps_from_camera[n]
        took_s = float(driven.time_s[n] - driven.time_s[n - 1])
        if took_s <= 0.0:
            # A sample without duration replaces the pose before it: it only records the settled state of the model.
            poses[-1] = after
            continue
        turned = vector_from_rotation(orthonormal(before[:3, :3].T @ after[:3, :3]))
        num = max(math.ceil(took_s * rate_hz - 1e-9), 1)
        for step in range(1, num):
            share = step / num
            between = np.eye(4)
            between[:3, :3] = orthonormal(before[:3, :3] @ rotation_from_vector(share * turned))
            between[:3, 3] = (1.0 - share) * before[:3, 3] + share * after[:3, 3]
            times.append(float(driven.time_s[n - 1]) + share * took_s)
            poses.append(between)
        times.append(float(driven.time_s[n]))
        poses.append(after)
    return np.array(times), tuple(Pose(pose) for pose in poses)
