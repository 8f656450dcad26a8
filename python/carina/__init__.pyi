"""Public names of Carina and the modules that define them; ``__init__.py`` loads each name on first use."""

from . import breathing as breathing
from . import case as case
from . import cluster as cluster
from . import commands as commands
from . import deidentification as deidentification
from . import errors as errors
from . import export as export
from . import navigate as navigate
from . import notebook as notebook
from . import pacs as pacs
from . import phantom as phantom
from . import plan as plan
from . import render as render
from . import scopes as scopes
from . import session as session
from . import track as track
from . import training as training
from . import volume as volume
from .deidentification import (
    deidentify as deidentify,
)
from .errors import (
    CarinaError as CarinaError,
    NoResultError as NoResultError,
    UsageError as UsageError,
    VolumeImportError as VolumeImportError,
)
from .export import (
    export_airways as export_airways,
    read_tree as read_tree,
    write_film as write_film,
    write_tree as write_tree,
)
from .navigate import (
    FlightPath as FlightPath,
    Navigator as Navigator,
)
from .notebook import (
    show as show,
)
from .phantom import (
    generate_mr_phantom as generate_mr_phantom,
    generate_phantom as generate_phantom,
    write_phantom as write_phantom,
)
from .plan import (
    Nodule as Nodule,
    Plan as Plan,
    grow_nodule as grow_nodule,
    plan_route as plan_route,
)
from .render import (
    Renderer as Renderer,
    TransferFunction as TransferFunction,
    isoregion_map as isoregion_map,
    render_surface as render_surface,
    render_view as render_view,
    transfer_preset as transfer_preset,
)
from .scopes import (
    Pose as Pose,
    ScopeDrive as ScopeDrive,
    WallField as WallField,
)
from .session import (
    Case as Case,
)
from .track import (
    Airways as Airways,
    AirwayTree as AirwayTree,
    edit_airways as edit_airways,
    find_airways as find_airways,
    measure_tree as measure_tree,
    track_paths as track_paths,
    wall_field as wall_field,
)
from .training import (
    insert_nodule as insert_nodule,
    score_recording as score_recording,
)
from .volume import (
    Volume as Volume,
    demo_patient as demo_patient,
    inspect_path as inspect_path,
    open_mask as open_mask,
    open_volume as open_volume,
)

__version__: str
__all__: list[str]
