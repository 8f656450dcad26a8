"""The processing functions that a session calls, as one value that tests can replace by simple functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from carina import plan, render, track, volume
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.lungs.lung_map import map_lungs
from carina.scopes import ScopePreset, scope_presets

if TYPE_CHECKING:
    from carina.plan import CArmAngles, DistanceOrigin, MovementMeasurement, Plan, PlanTarget, ReachAtlas, Verdict
    from carina.plan.lungs.lung_map import LungMap
    from carina.render import TransferFunction
    from carina.session.scene.shown_case import SessionRenderer
    from carina.track import Airways, CtAssessment, EditPreview, TreeMeasures
    from carina.volume import Mask, Volume

Progress = Callable[[str, float | None], None]
Cancel = Callable[[], bool]


class RendererFactory(Protocol):
    """Factory of renderers, on one machine or on a cluster."""

    def __call__(self, volume: Volume, transfer: TransferFunction) -> SessionRenderer:
        """Create a renderer that shows the volume with a transfer function."""


@one_line
@dataclass(frozen=True, slots=True)
class Parts:
    """Processing functions of a session; the public functions of the same names define their contracts."""

    open_volume: Callable[..., Volume]
    """Opens a CT: ``open_volume(path, progress, cancel)``, for one of several DICOM series with ``series=``."""
    open_demo: Callable[[str, Progress, Cancel], Volume]
    quality_words: Callable[[Volume], tuple[str, ...]]
    """Returns the findings of the quality gate, which are known when a CT is shown."""
    find_airways: Callable[..., Airways]
    """Segments the airways, or builds their tree from a mask.

    The call is ``find_airways(volume, root_lps=, lumen_threshold=, progress=, cancel=)``, for a mask with the further
    arguments ``lumen_zyx=, notes=``.
    """
    transfer_preset: Callable[[str], TransferFunction]
    transfer_from_json: Callable[[dict[str, Any]], TransferFunction]
    transfer_from_histogram: Callable[[Volume], tuple[TransferFunction, float]]
    measure_tree: Callable[..., TreeMeasures] | None = None
    """Measures branches: ``measure_tree(volume, airways, previous=, progress=, cancel=)``; None measures nothing."""
    assess_ct: Callable[[Volume, Airways | None], CtAssessment] = track.assess_ct
    """Assesses a CT in HU for the airway search; the part without airways is cached with the volume."""
    wall_field: Callable[..., Any] = track.wall_field
    """Computes the field of distances to the airway wall: ``wall_field(volume, airways, progress=, cancel=)``."""
    presets: tuple[str, ...] = ("endoscopic", "ct-grey", "see-through", "paper")
    edit_airways: Callable[..., Airways] = track.edit_airways
    """Returns edited airways: ``edit_airways(volume, airways, edit, progress=, cancel=)``."""
    preview_edit: Callable[..., EditPreview] = track.preview_edit
    """Returns the preview of an edit: ``preview_edit(volume, airways, edit, with_names=)``."""
    open_mask: Callable[..., Mask] = volume.open_mask
    """Reads a segmentation: ``open_mask(path, volume, label=, resample=, progress=, cancel=)``."""
    target_from_click: Callable[..., PlanTarget] = plan.target_from_click
    """Segments the target at a point (LPS, mm).

    The call is ``target_from_click(volume, at_lps, target_id=, name=, airways=, wall=, progress=)``.
    """
    measure_movement: Callable[..., MovementMeasurement] = plan.measure_movement
    """Measures a target's movement: ``measure_movement(volume, airways, target, volume2, airways2, ...)``."""
    plan_route: Callable[..., Plan] = plan.plan_route
    """Plans the routes to a target: ``plan_route(volume, airways, target, scope=, tool=, ...)``."""
    judge_scopes: Callable[..., tuple[Verdict, ...]] = plan.judge_scopes
    """Computes the verdicts on a planned route.

    The call is ``judge_scopes(tree, plan, wall, route=, scopes=, origin_depth_mm=, found=, progress=, cancel=)``.
    """
    judge_pairs: Callable[..., tuple[Verdict, ...]] = plan.judge_pairs
    """Computes the verdicts on pairs of route and instrument.

    The call is ``judge_pairs(tree, plan, wall, scopes=, origin_depth_mm=, found=, progress=, cancel=)``.
    """
    carm_angles: Callable[..., CArmAngles] = plan.carm_angles
    """Returns the positions of a C-arm for a route.

    The call is ``carm_angles(volume, airways, plan, route_number=, shadows=, cancel=)``.
    """
    map_lungs: Callable[..., LungMap] = map_lungs
    """Maps vessels, fissures and lobes: ``map_lungs(volume, airways, wall, progress=, found=)``."""
    distance_origin: Callable[[Volume, Airways], DistanceOrigin] = plan.distance_origin
    """Returns the origin of distances, the ridge of the main carina: ``distance_origin(volume, airways)``."""
    reach_atlas: Callable[..., ReachAtlas] = plan.reach_atlas
    """Maps an instrument's reach: ``reach_atlas(volume, airways, scope=, tool=, wall=, progress=, cancel=)``."""
    scope_presets: Callable[[], tuple[ScopePreset, ...]] = scope_presets
    """Returns the instruments for which verdicts are computed."""


def default_parts() -> Parts:
    """Return Carina's own processing functions, which a session uses unless a test replaces them."""

    def open_volume(path: str, progress: Progress, cancel: Cancel, series: str | None = None) -> Volume:
        return volume.open_volume(path, series=series, progress=progress, cancel=cancel)

    def open_demo(name: str, progress: Progress, cancel: Cancel) -> Volume:
        if name == "phantom":
            from carina import phantom

            return phantom.demo_phantom(progress=progress, cancel=cancel).volume
        if name == "patient":
            return volume.demo_patient(progress=progress, cancel=cancel)
        raise UsageError(f"expected the demo 'phantom' or 'patient'; found {name!r}")

    return Parts(
        open_volume=open_volume,
        open_demo=open_demo,
        quality_words=lambda v: tuple(f.words for f in volume.quality_gate(v).findings),
        find_airways=track.find_airways,
        measure_tree=track.measure_tree,
        transfer_preset=render.transfer_preset,
        transfer_from_json=render.TransferFunction.from_json,
        transfer_from_histogram=render.transfer_from_histogram,
    )
