"""Airway lumen, least-cost paths and the airway tree (paper 6)."""

from carina.track.ct_assessment import CtAssessment, CtProperty, assess_ct
from carina.track.edit.add_branch_path import BranchWay, branch_way
from carina.track.edit.edits import (
    AddBranch,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    TreeEdit,
    edit_airways,
    edit_words,
    edits_from_json,
    edits_to_json,
    name_edited,
    rebuild_airways,
    renaming_texts,
)
from carina.track.edit.preview import preview_edit
from carina.track.edit.preview_lines import EditPreview, PreviewLine
from carina.track.edit.undo_storage import FoldedAirways, fold_airways
from carina.track.find.airways import find_airways
from carina.track.find.result import Airways
from carina.track.intensity_levels import lumen_threshold_from_histogram
from carina.track.measures.branch_measures import (
    BranchMeasures,
    BranchSummary,
    ForkMeasures,
    Stenosis,
    TreeMeasures,
    measure_tree,
)
from carina.track.names.absent import Absence, find_absent
from carina.track.names.naming import LetterRule, NameWords, branch_side_and_lobe, name_tree, name_words
from carina.track.names.renaming import RenamedBranch, renamed_branches
from carina.track.paths.live_path import LivePath
from carina.track.paths.tracker import PathTracker, TrackedPath
from carina.track.paths.volume_paths import FieldPath, FieldPaths, aimed_path
from carina.track.surface.mesh import Mesh, lumen_mask, lumen_mesh, mask_mesh
from carina.track.surface.outline import LumenOutline, MaskOutline
from carina.track.surface.wall import wall_field
from carina.track.targets.results import TargetResult, TrackResult
from carina.track.targets.tracking import track_paths
from carina.track.tree.airway_tree import AirwayTree, Branch, Route, TreeRow
from carina.track.tree.drawn_parts import DrawnPart, drawn_part, drawn_tree, kind_words
from carina.track.tree.path_between import way_between
from carina.track.tree.thick_slices import CalibratedShares, CalibreShare
from carina.track.tree.uncertainty import Uncertainty

__all__ = [
    "Absence",
    "AddBranch",
    "AirwayTree",
    "Airways",
    "Branch",
    "BranchMeasures",
    "BranchSummary",
    "BranchWay",
    "Bridge",
    "CalibratedShares",
    "CalibreShare",
    "CtAssessment",
    "CtProperty",
    "CutBranch",
    "DrawnPart",
    "EditPreview",
    "FieldPath",
    "FieldPaths",
    "FoldedAirways",
    "ForkMeasures",
    "LetterRule",
    "LivePath",
    "LumenOutline",
    "MaskOutline",
    "Mesh",
    "MoveFork",
    "MoveRoot",
    "NameWords",
    "PaintLumen",
    "PathTracker",
    "PreviewLine",
    "RenameBranch",
    "RenamedBranch",
    "Route",
    "SmoothBranch",
    "Stenosis",
    "TargetResult",
    "TrackResult",
    "TrackedPath",
    "TreeEdit",
    "TreeMeasures",
    "TreeRow",
    "Uncertainty",
    "aimed_path",
    "assess_ct",
    "branch_side_and_lobe",
    "branch_way",
    "drawn_part",
    "drawn_tree",
    "edit_airways",
    "edit_words",
    "edits_from_json",
    "edits_to_json",
    "find_absent",
    "find_airways",
    "fold_airways",
    "kind_words",
    "lumen_mask",
    "lumen_mesh",
    "lumen_threshold_from_histogram",
    "mask_mesh",
    "measure_tree",
    "name_edited",
    "name_tree",
    "name_words",
    "preview_edit",
    "rebuild_airways",
    "renamed_branches",
    "renaming_texts",
    "track_paths",
    "wall_field",
    "way_between",
]
