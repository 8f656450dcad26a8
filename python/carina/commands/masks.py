"""Commands that use a mask of another tool as the airways."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.value import Command, LocalCommand


class TakeMask(LocalCommand, frozen=True):
    """Use the mask in a file as the airway lumen of the open case; undoable.

    If the file contains several structures or has another grid, nothing is changed, and ``Snapshot.mask_question``
    contains the question for the user.
    """

    path: str
    """Path of a NIfTI, NRRD, MetaImage or DICOM SEG file."""
    label: int | None = None
    resample: bool = False


class AnswerMask(Command, frozen=True):
    """Answer ``state.mask_question``: the label of the airways, and whether to resample."""

    label: Annotated[int, Meta(ge=-(2**53), le=2**53)] | None = None
    resample: bool = False


class DismissMask(Command, frozen=True):
    """Discard the imported mask about which ``state.mask_question`` asks."""
