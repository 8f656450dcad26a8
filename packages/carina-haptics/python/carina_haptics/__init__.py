"""Force feedback for bronchoscopy devices: the wall of the airways as a force, 1,000 times a second (paper 7).

The package depends on Carina; Carina does not import it. The guide is ``packages/carina-haptics/README.md``.
"""

from carina_haptics.force_loop import (
    FORCE_LIMIT_N,
    FORCE_SLEW_N_PER_MS,
    MAX_STIFFNESS_N_PER_MM,
    ForceFigures,
    ForceLaw,
    ForceLoop,
    HandForce,
    forces_along,
)
from carina_haptics.gamepad import rumble
from carina_haptics.haply import HAPLY_URL, HaplyBridge, HaplyState, read_haply_message
from carina_haptics.packets import ForceReply, decode_force, encode_sample

__all__ = [
    "FORCE_LIMIT_N",
    "FORCE_SLEW_N_PER_MS",
    "HAPLY_URL",
    "MAX_STIFFNESS_N_PER_MM",
    "ForceFigures",
    "ForceLaw",
    "ForceLoop",
    "ForceReply",
    "HandForce",
    "HaplyBridge",
    "HaplyState",
    "decode_force",
    "encode_sample",
    "forces_along",
    "read_haply_message",
    "rumble",
]
