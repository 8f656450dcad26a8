"""Wall of the airways as a signed distance field, for the scope that moves in them."""

from __future__ import annotations

from carina.argument_checks import check_arguments, function, instance, number_from
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import check_type
from carina.scopes import WallField
from carina.track.find.result import Airways
from carina.track.progress import Cancel
from carina.track.surface.mesh import lumen_mesh
from carina.volume.model import Volume


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    spacing_mm=number_from(0.1, 0.6, unit="mm"),
    cancel=function,
)
def wall_field(
    volume: Volume,
    airways: Airways,
    *,
    spacing_mm: float = 0.4,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> WallField:
    """Compute the signed distance to the sub-voxel wall of the airways, exact at the samples.

    Parameters
    ----------
    volume, airways
        The CT and the airways in it, as for `lumen_mesh`.
    spacing_mm
        Distance between the samples.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Returns
    -------
    WallField
        Signed distance to the wall in mm, positive in the lumen.

    Raises
    ------
    NoResultError
        If the lumen is empty.
    CancelledError
        If ``cancel()`` returned True.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> wall = carina.wall_field(phantom.volume, airways)
    >>> trachea = airways.tree.root.points
    >>> bool(wall.distance_mm(trachea[len(trachea) // 2])[0] > 4.0)
    True
    """
    check_type("wall_field", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("wall_field", "airways", airways, Airways, "get airways from carina.find_airways")
    report = progress_function(progress)
    mesh = lumen_mesh(volume, airways, progress=report, cancel=cancel)
    return WallField.from_mesh(mesh.vertices_lps, mesh.triangles, spacing_mm=spacing_mm, progress=report, cancel=cancel)
