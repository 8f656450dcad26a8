"""Messages from a client to the server."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import BranchId, Count, Identifier, OwnName, Pixels, PointLps, ProcessorName, ViewName
from carina.commands.value import FrozenValue
from carina.render import VIEW_NAMES
from carina.server.wire.codec import ClientMessage
from carina.session.scene.layer_lines import LayerName


class AskAtPlace(FrozenValue, frozen=True):
    """Request about a point, or about a position in an airway image."""

    request_id: Count
    """ID that the answer repeats."""
    lps: PointLps | None
    frame_id: Count | None
    column: Annotated[float, Meta(ge=0.0, le=4096.0)] | None
    row: Annotated[float, Meta(ge=0.0, le=4096.0)] | None

    def choice_problem(self) -> str | None:
        """Require either a point or a position in an airway image."""
        in_picture = [part is not None for part in (self.frame_id, self.column, self.row)]
        if any(in_picture) != all(in_picture) or (self.lps is None) != all(in_picture):
            return f"{self.__struct_config__.tag} needs either a point or a position in an image"
        return None


class ClientHello(ClientMessage, frozen=True, tag="hello"):
    """First message of a client."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    token: Annotated[str, Meta(max_length=200)] | None = None
    """Token of the link of an observer; other clients need no token."""


class OpenUpload(ClientMessage, frozen=True):
    """Open the files sent to ``/api/upload``."""

    upload_id: Identifier


class ImportMask(ClientMessage, frozen=True):
    """Take the mask sent to ``/api/upload`` as the airways of the open case; undoable."""

    upload_id: Identifier


class ImportTarget(ClientMessage, frozen=True):
    """Take the file sent to ``/api/upload`` as a target: a mask, a DICOM SEG or an RTSTRUCT; undoable."""

    upload_id: Identifier
    structure: OwnName | None = None
    """Name or number of the structure if the file contains several."""


class MeasureUpload(ClientMessage, frozen=True):
    """Measure the movement of a target from the second CT sent to ``/api/upload``; undoable."""

    target_id: Identifier
    upload_id: Identifier


class ViewSize(FrozenValue, frozen=True):
    """A visible view and its size in device pixels."""

    view: ViewName
    width: Pixels
    height: Pixels


class Layout(ClientMessage, frozen=True):
    """Views on the screen; only these views are rendered."""

    views: Annotated[tuple[ViewSize, ...], Meta(max_length=len(VIEW_NAMES))]

    def choice_problem(self) -> str | None:
        """Require that each view occurs only once."""
        return (
            None
            if len({v.view for v in self.views}) == len(self.views)
            else "the layout contains a view more than once"
        )


class Ack(ClientMessage, frozen=True):
    """Report that a picture was decoded; acknowledgements that the page has delayed follow one another."""

    frame_id: Count


class Probe(ClientMessage, frozen=True):
    """Request the value of the voxel at a point; the answer is ``value``."""

    lps: PointLps


class Pick(ClientMessage, frozen=True):
    """Request the wall position under a pixel of an airway image; the answer is ``picked``."""

    pick_id: Count
    """ID that the answer repeats."""
    frame_id: Count
    """ID of the displayed frame; the tip may have moved since."""
    column: Annotated[float, Meta(ge=0.0, le=4096.0)]
    """Corner coordinates of that picture's own pixels (centre of the first = 0.5)."""
    row: Annotated[float, Meta(ge=0.0, le=4096.0)]


class AskLivePath(AskAtPlace, ClientMessage, frozen=True, tag="live_path"):
    """Request the path from the root to a point under the cursor; only the newest is answered, by ``live_path``.

    The request contains either a point or a position in an airway picture, as in ``pick``. For a position, the path
    ends in the lumen in front of the wall at this position.
    """


class BranchQuestion(FrozenValue, frozen=True):
    """Request about a branch; the answer repeats both IDs."""

    request_id: Count
    branch_id: BranchId


class AskBranchDetail(BranchQuestion, ClientMessage, frozen=True, tag="branch_detail"):
    """Request the measurements along a branch; only the newest request is answered, by ``branch_detail``."""


class SetFrameRate(ClientMessage, frozen=True):
    """Set the frame rate of the moving airway view; resolution is reduced first, then the ray step is enlarged."""

    rate_hz: Annotated[float, Meta(ge=5.0, le=240.0)]


class SetProcessor(ClientMessage, frozen=True):
    """Choose the processor of airway views for all windows and later starts; the answer is ``processor_choice``."""

    choice: ProcessorName


class SetLayers(ClientMessage, frozen=True):
    """Select the layers of the lung map on the slices of this window; the default is all layers."""

    layers: Annotated[tuple[LayerName, ...], Meta(max_length=8)]


class AskSeriesPictures(ClientMessage, frozen=True):
    """Request a picture of each series of a folder, by a job; each answer is a ``series_picture``."""

    list_id: Identifier | None = None
    """``opening.list_id`` of a folder that is being opened; null for the folder of the open CT."""


class StopSeriesPictures(ClientMessage, frozen=True):
    """Stop the job of ``ask_series_pictures``, because the window has closed the list of series."""


class AskStorage(ClientMessage, frozen=True):
    """Request the present disk usage of the cases and their CTs; the answer is ``start``."""


class SetWatchPage(ClientMessage, frozen=True):
    """Open the viewing page in the local network with a new certificate and link, or close it.

    If the page is open, ``on`` leaves the link unchanged.
    """

    on: bool
    learners: bool = False
    """Whether observers receive the learners of the training, for a teacher: pseudonyms, attempts and scores."""


class SendAway(ClientMessage, frozen=True):
    """Disconnect an observer, and replace the link so that the previous link no longer works."""

    number: Count


class AcceptNotice(ClientMessage, frozen=True):
    """Confirmation that the user read the notice "Not a medical device"."""


class ReadHints(ClientMessage, frozen=True):
    """Report that the user has read or closed the hints of the first minute."""
