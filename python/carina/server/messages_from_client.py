"""What a client sends."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import BranchId, Count, Identifier, OwnName, Pixels, PointLps, ViewName
from carina.commands.value import FrozenValue
from carina.render import VIEW_NAMES
from carina.server.wire_codec import ClientMessage
from carina.session.layers import LayerName


class AskAtPlace(FrozenValue, frozen=True):
    """A question about a point, or about a place in an airway picture."""

    request_id: Count
    """Named by the answer."""
    lps: PointLps | None
    frame_id: Count | None
    column: Annotated[float, Meta(ge=0.0, le=4096.0)] | None
    row: Annotated[float, Meta(ge=0.0, le=4096.0)] | None

    def choice_problem(self) -> str | None:
        """A point or a place."""
        in_picture = [part is not None for part in (self.frame_id, self.column, self.row)]
        if any(in_picture) != all(in_picture) or (self.lps is None) != all(in_picture):
            return f"{self.__struct_config__.tag} needs either a point or a position in an image"
        return None


class ClientHello(ClientMessage, frozen=True, tag="hello"):
    """First message of a client."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    token: Annotated[str, Meta(max_length=200)] | None = None
    """Of the link by which a watcher came; nobody else needs one here."""


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
    """Its name or number, where the file has several."""


class ViewSize(FrozenValue, frozen=True):
    """A visible view and its size in device pixels."""

    view: ViewName
    width: Pixels
    height: Pixels


class Layout(ClientMessage, frozen=True):
    """The views on screen; no others are rendered."""

    views: Annotated[tuple[ViewSize, ...], Meta(max_length=len(VIEW_NAMES))]

    def choice_problem(self) -> str | None:
        """Each view once."""
        return (
            None
            if len({v.view for v in self.views}) == len(self.views)
            else "the layout contains a view more than once"
        )


class Ack(ClientMessage, frozen=True):
    """A picture was decoded; coalesced acks may be sent one after the other."""

    frame_id: Count


class Probe(ClientMessage, frozen=True):
    """Ask for the number of the voxel at a point; the answer is ``value``."""

    lps: PointLps


class Pick(ClientMessage, frozen=True):
    """Ask for the wall under a place in an airway picture; the answer is ``picked``."""

    pick_id: Count
    """Named by the answer."""
    frame_id: Count
    """The picture that is on the screen: the tip may have moved on since."""
    column: Annotated[float, Meta(ge=0.0, le=4096.0)]
    """Corner coordinates of that picture's own pixels (centre of the first = 0.5)."""
    row: Annotated[float, Meta(ge=0.0, le=4096.0)]


class AskLivePath(AskAtPlace, ClientMessage, frozen=True, tag="live_path"):
    """Ask for the path from the root to a place under the cursor; only the newest is answered, by ``live_path``.

    Either a point, or a place in an airway picture, as in ``pick``: then the lumen in front of the wall there is meant.
    """


class BranchQuestion(FrozenValue, frozen=True):
    """A branch that is asked about; its answer names both again."""

    request_id: Count
    branch_id: BranchId


class AskBranchDetail(BranchQuestion, ClientMessage, frozen=True, tag="branch_detail"):
    """Ask for what was measured along a branch; only the newest is answered, by ``branch_detail``."""


class SetFrameRate(ClientMessage, frozen=True):
    """Ask for so many airway pictures per second while moving; resolution gives way to it, then the ray step."""

    rate_hz: Annotated[float, Meta(ge=5.0, le=240.0)]


class SetLayers(ClientMessage, frozen=True):
    """Which of what was mapped round the targets this window's slices carry; all of it, unless told."""

    layers: Annotated[tuple[LayerName, ...], Meta(max_length=8)]


class AskStorage(ClientMessage, frozen=True):
    """Ask what the cases and their CTs take on the disk now; the answer is ``start``."""


class SetWatchPage(ClientMessage, frozen=True):
    """Show the open case to this machine's network, with a new certificate and link, or to nobody."""

    on: bool


class SendAway(ClientMessage, frozen=True):
    """End a watcher's connection, and change the link so that nobody comes back by it."""

    number: Count


class AcceptNotice(ClientMessage, frozen=True):
    """ "Not a medical device" was read."""
