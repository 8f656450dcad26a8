"""Export of airways, plans and videos to files."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from carina.export.airways_file import check_export, export_airways, export_tree, is_tree_file
from carina.export.film import Film, write_film
from carina.export.format_table import EXPORT_FORMATS, EXPORT_SUFFIXES, EXPORT_TITLES, ExportFormat, export_format
from carina.export.mask_file import MASK_SUFFIXES, check_mask_file, write_mask
from carina.export.mesh_file import write_mesh
from carina.export.plan_file import PLAN_FORMATS, check_plan_file, export_plan
from carina.export.plan_markups import write_plan_markups
from carina.export.plan_nrrd import write_target_nrrd
from carina.export.plan_openigtlink import PlanServer, plan_messages, send_plan
from carina.export.printable_mould import PrintableMould, printable_mould
from carina.export.printable_phantom import PrintablePhantom, printable_phantom
from carina.export.tree_file import read_badges, read_tree, write_tree
from carina.export.tree_formats import write_markups, write_swc, write_vtp
from carina.export.video import VIDEO_SUFFIXES, VideoWriter

if TYPE_CHECKING:
    from carina.export.plan_dicom_pdf import write_plan_pdf
    from carina.export.plan_dicom_seg import write_target_seg
    from carina.export.plan_dicom_sr import write_target_report

# Names that need pydicom are imported on first use, because other exports work without it.
_HOME = {
    "write_plan_pdf": "plan_dicom_pdf",
    "write_target_report": "plan_dicom_sr",
    "write_target_seg": "plan_dicom_seg",
}

__all__ = [
    "EXPORT_FORMATS",
    "EXPORT_SUFFIXES",
    "EXPORT_TITLES",
    "MASK_SUFFIXES",
    "PLAN_FORMATS",
    "VIDEO_SUFFIXES",
    "ExportFormat",
    "Film",
    "PlanServer",
    "PrintableMould",
    "PrintablePhantom",
    "VideoWriter",
    "check_export",
    "check_mask_file",
    "check_plan_file",
    "export_airways",
    "export_format",
    "export_plan",
    "export_tree",
    "is_tree_file",
    "plan_messages",
    "printable_mould",
    "printable_phantom",
    "read_badges",
    "read_tree",
    "send_plan",
    "write_film",
    "write_markups",
    "write_mask",
    "write_mesh",
    "write_plan_markups",
    "write_plan_pdf",
    "write_swc",
    "write_target_nrrd",
    "write_target_report",
    "write_target_seg",
    "write_tree",
    "write_vtp",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        msg = f"module 'carina.export' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(importlib.import_module(f"carina.export.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
