"""The messages between server and client, gathered, and how they are read and written (prose: ``protocol/README.md``).

They are frozen dataclasses in ``messages_from_client.py``, ``messages_from_server.py``, ``messages_of_tree.py``,
``messages_of_edits.py``, ``messages_of_devices.py`` and ``messages_of_phone.py`` (between the server and a phone's
page, on a socket of its own).

``web/src/wire/messages.ts`` and ``protocol/schema.json`` are generated from them by
``python -m carina.server.wire_types``; a test fails when they drift apart. World is LPS mm, matrices are 4x4 row-major,
units are in the names. Numbers are bounded so that no client can ask for a picture or a volume of any size.
"""

from __future__ import annotations

import json
import struct
from typing import Any

from carina.errors import ProtocolError
from carina.server.messages_from_client import (
    AcceptNotice,
    Ack,
    AddTarget,
    AnswerMask,
    AskBranchDetail,
    AskLivePath,
    Cancel,
    ChooseRoute,
    ClientHello,
    CloseCase,
    DismissMask,
    GoTo,
    ImportMask,
    Layout,
    LevelHorizon,
    NextFork,
    OpenDemo,
    OpenPath,
    OpenRecent,
    OpenUpload,
    Pick,
    Place,
    PreviousFork,
    Probe,
    Redo,
    RemoveTarget,
    ResetLook,
    SetCarm,
    SetCrosshair,
    SetFov,
    SetFrameRate,
    SetLumenThreshold,
    SetMask,
    SetMethod,
    SetMode,
    SetOperator,
    SetOrbit,
    SetReformation,
    SetRoot,
    SetScope,
    SetShading,
    SetSlab,
    SetTexture,
    SetTransfer,
    SetWindow,
    SetZoom,
    ShowPlace,
    Steer,
    ToggleMode,
    Undo,
    ViewSize,
)
from carina.server.messages_from_server import (
    Carm,
    CaseInfo,
    CaseNote,
    Cluster,
    ClusterMember,
    Demo,
    Done,
    Error,
    FeatureOff,
    GreyWindow,
    HeldScope,
    MaskLabel,
    MaskQuestion,
    Notice,
    Orbit,
    OtherSeries,
    Picked,
    PictureHeader,
    PictureLens,
    PictureLines,
    PictureOutline,
    Pose,
    Progress,
    RecentCase,
    Reformation,
    Route,
    RouteInfo,
    RouteSpan,
    Scope,
    ServerHello,
    Slab,
    Start,
    State,
    Status,
    Target,
    Value,
    Zoom,
)
from carina.server.messages_of_devices import (
    ArmPen,
    AskContact,
    Calibrate,
    ConnectDevice,
    DeviceControls,
    DeviceGone,
    DeviceInfo,
    Devices,
    DeviceSample,
    DeviceSource,
    DisconnectDevice,
    ForcePlane,
    JoinPen,
    LocalContact,
    Pen,
    PhoneInfo,
    PublishTip,
    SetControl,
    SetControls,
    SetPhone,
    StartRecording,
    StopRecording,
    TakeDevice,
    WatchDevices,
)
from carina.server.messages_of_edits import (
    AskEditPreview,
    EditAddBranch,
    EditBridge,
    EditCutBranch,
    EditLine,
    EditMoveFork,
    EditMoveRoot,
    EditPaintLumen,
    EditPreview,
    EditRenameBranch,
    EditSmoothBranch,
    EditTree,
    NoEvidence,
)
from carina.server.messages_of_keys import (
    EditKeys,
    FlyKeys,
    KeyAdd,
    KeyFrame,
    KeyMove,
    KeyRemove,
    KeyRename,
    Keys,
    KeySpeed,
    KeyUpdate,
    OpenKeys,
    SetKeyFlight,
    ShowKey,
)
from carina.server.messages_of_phone import PhoneAct, PhoneHello, PhoneSample, PhoneState
from carina.server.messages_of_tree import (
    BranchDetail,
    BranchMeasures,
    BranchProfile,
    BranchTitle,
    LivePath,
    Tree,
    TreeBranch,
    TreeDocument,
    UncertainPlace,
)
from carina.server.wire_codec import decode_fields, load_json_object, split_picture, to_jsonable
from carina.server.wire_fields import Mask, ViewName

__all__ = [
    "CLIENT_MESSAGES",
    "CLOSE_CODES",
    "SERVER_MESSAGES",
    "WIRE_VERSION",
    "AcceptNotice",
    "Ack",
    "AddTarget",
    "AnswerMask",
    "ArmPen",
    "AskBranchDetail",
    "AskContact",
    "AskEditPreview",
    "AskLivePath",
    "BranchDetail",
    "BranchMeasures",
    "BranchProfile",
    "BranchTitle",
    "Calibrate",
    "Cancel",
    "Carm",
    "CaseInfo",
    "CaseNote",
    "ChooseRoute",
    "ClientHello",
    "CloseCase",
    "Cluster",
    "ClusterMember",
    "ConnectDevice",
    "Demo",
    "DeviceControls",
    "DeviceGone",
    "DeviceInfo",
    "DeviceSample",
    "DeviceSource",
    "Devices",
    "DisconnectDevice",
    "DismissMask",
    "Done",
    "EditAddBranch",
    "EditBridge",
    "EditCutBranch",
    "EditKeys",
    "EditLine",
    "EditMoveFork",
    "EditMoveRoot",
    "EditPaintLumen",
    "EditPreview",
    "EditRenameBranch",
    "EditSmoothBranch",
    "EditTree",
    "Error",
    "FeatureOff",
    "FlyKeys",
    "ForcePlane",
    "GoTo",
    "GreyWindow",
    "HeldScope",
    "ImportMask",
    "JoinPen",
    "KeyAdd",
    "KeyFrame",
    "KeyMove",
    "KeyRemove",
    "KeyRename",
    "KeySpeed",
    "KeyUpdate",
    "Keys",
    "Layout",
    "LevelHorizon",
    "LivePath",
    "LocalContact",
    "Mask",
    "MaskLabel",
    "MaskQuestion",
    "NextFork",
    "NoEvidence",
    "Notice",
    "OpenDemo",
    "OpenKeys",
    "OpenPath",
    "OpenRecent",
    "OpenUpload",
    "Orbit",
    "OtherSeries",
    "Pen",
    "PhoneAct",
    "PhoneHello",
    "PhoneInfo",
    "PhoneSample",
    "PhoneState",
    "Pick",
    "Picked",
    "PictureHeader",
    "PictureLens",
    "PictureLines",
    "PictureOutline",
    "Place",
    "Pose",
    "PreviousFork",
    "Probe",
    "Progress",
    "PublishTip",
    "RecentCase",
    "Redo",
    "Reformation",
    "RemoveTarget",
    "ResetLook",
    "Route",
    "RouteInfo",
    "RouteSpan",
    "Scope",
    "ServerHello",
    "SetCarm",
    "SetControl",
    "SetControls",
    "SetCrosshair",
    "SetFov",
    "SetFrameRate",
    "SetKeyFlight",
    "SetLumenThreshold",
    "SetMask",
    "SetMethod",
    "SetMode",
    "SetOperator",
    "SetOrbit",
    "SetPhone",
    "SetReformation",
    "SetRoot",
    "SetScope",
    "SetShading",
    "SetSlab",
    "SetTexture",
    "SetTransfer",
    "SetWindow",
    "SetZoom",
    "ShowKey",
    "ShowPlace",
    "Slab",
    "Start",
    "StartRecording",
    "State",
    "Status",
    "Steer",
    "StopRecording",
    "TakeDevice",
    "Target",
    "ToggleMode",
    "Tree",
    "TreeBranch",
    "TreeDocument",
    "UncertainPlace",
    "Undo",
    "Value",
    "ViewName",
    "ViewSize",
    "WatchDevices",
    "Zoom",
    "encode_message",
    "parse_client_message",
    "parse_force_message",
    "parse_phone_message",
    "parse_picture",
    "parse_server_message",
    "parse_to_force_message",
    "parse_to_phone_message",
    "split_outline",
]

WIRE_VERSION = 1

CLOSE_CODES: dict[str, int] = {
    "protocol.malformed": 4400,
    "protocol.not-authorised": 4401,
    "protocol.version": 4402,
    "protocol.order": 4403,
    "protocol.taken-over": 4409,
    "protocol.slow-client": 4413,
}
"""Why the server closes a socket; each comes with one sentence."""


def _by_type(*classes: type[Any]) -> dict[str, type[Any]]:
    return {cls.wire_type: cls for cls in classes}


CLIENT_MESSAGES = _by_type(
    ClientHello, OpenPath, OpenDemo, OpenUpload, OpenRecent, ImportMask, AnswerMask, DismissMask, CloseCase, Cancel,
    Layout, Ack, Steer, SetMode, ToggleMode, GoTo, NextFork, PreviousFork, Place, ShowPlace, LevelHorizon,
    ResetLook,
    SetOperator, SetRoot, AddTarget, RemoveTarget, ChooseRoute, SetCrosshair, SetWindow, SetFov, SetScope, SetMask,
    SetTransfer, SetShading, SetTexture, SetMethod, SetLumenThreshold, SetOrbit, SetZoom, SetCarm, SetReformation,
    SetSlab, SetFrameRate, Probe, Pick, AskLivePath, AskBranchDetail, EditTree, AskEditPreview,
    Undo, Redo, AcceptNotice,
    DeviceSample, DeviceGone, TakeDevice, SetControl, SetControls, Calibrate, ArmPen, JoinPen, ConnectDevice,
    DisconnectDevice, PublishTip, SetPhone, WatchDevices, StartRecording, StopRecording,
    EditKeys, SetKeyFlight, ShowKey, FlyKeys, OpenKeys,
)  # fmt: skip
SERVER_MESSAGES = _by_type(
    ServerHello, Start, State, Tree, Route, Pose, Value, Picked, LivePath, BranchDetail, EditPreview, NoEvidence,
    Progress, Done, Error, Notice, Status, Devices, Pen, Cluster, Keys,
)  # fmt: skip
FORCE_MESSAGES = _by_type(ClientHello, AskContact)
"""What a bridge to a force device sends on ``/force``; no window speaks these, so TypeScript does not know them."""
TO_FORCE_MESSAGES = _by_type(ServerHello, LocalContact)
MAX_FORCE_BYTES = 2048
PHONE_MESSAGES = _by_type(PhoneHello, PhoneSample, PhoneAct)
TO_PHONE_MESSAGES = _by_type(PhoneState)
MAX_PHONE_BYTES = 2048
"""Largest message of a phone; its samples have 200."""


def _parse(classes: dict[str, type[Any]], text: str | bytes, max_bytes: int) -> Any:
    fields = load_json_object(text, max_bytes=max_bytes)
    name = fields.pop("type", None)
    if not isinstance(name, str) or name not in classes:
        shown = repr(name)[:40] if isinstance(name, str) else "none"
        raise ProtocolError(f"a message has a type that is not known: {shown}", code="protocol.type")
    return decode_fields(classes[name], fields, name)


def parse_client_message(text: str | bytes, *, max_bytes: int = 262_144) -> Any:
    """One message of a client.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    message = _parse(CLIENT_MESSAGES, text, max_bytes)
    # What the schema cannot express: "exactly one of".
    if isinstance(message, ChooseRoute) and message.target_id is not None and message.branch_id is not None:
        raise ProtocolError("choose_route names a target and a branch; it may name one", code="protocol.choice")
    if isinstance(message, SetTransfer) and (message.preset is None) == (message.document is None):
        raise ProtocolError("set_transfer needs either a preset or a document", code="protocol.choice")
    if isinstance(message, AskLivePath | AskEditPreview):
        in_picture = [part is not None for part in (message.frame_id, message.column, message.row)]
        if any(in_picture) != all(in_picture) or (message.lps is None) != all(in_picture):
            words = f"{message.wire_type} needs either a point or a place in a picture"
            raise ProtocolError(words, code="protocol.choice")
    if isinstance(message, AskEditPreview) and (message.branch_id is None) == (message.tool == "move-fork"):
        raise ProtocolError("preview_edit names a branch for move-fork, and for it alone", code="protocol.choice")
    if isinstance(message, DeviceSample):
        kinds = (message.orientation_wxyz, message.axes, message.handle)
        if sum(kind is not None for kind in kinds) != 1:
            raise ProtocolError("device_sample needs an orientation, axes or a handle", code="protocol.choice")
    if isinstance(message, DeviceSample) and message.position_mm is not None and message.orientation_wxyz is None:
        raise ProtocolError("device_sample has a position without an orientation", code="protocol.choice")
    if isinstance(message, Layout) and len({v.view for v in message.views}) != len(message.views):
        raise ProtocolError("layout names a view twice", code="protocol.choice")
    return message


def parse_force_message(text: str | bytes) -> Any:
    """One message of a bridge to a force device.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    return _parse(FORCE_MESSAGES, text, MAX_FORCE_BYTES)


def parse_to_force_message(text: str | bytes) -> Any:
    """One message of the server to a bridge; for bridges in Python, and tests."""
    return _parse(TO_FORCE_MESSAGES, text, MAX_FORCE_BYTES)


def parse_phone_message(text: str | bytes) -> Any:
    """One message of the page for a phone.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    return _parse(PHONE_MESSAGES, text, MAX_PHONE_BYTES)


def parse_to_phone_message(text: str | bytes) -> Any:
    """One message of the server to a phone's page; for tests."""
    return _parse(TO_PHONE_MESSAGES, text, MAX_PHONE_BYTES)


def parse_server_message(text: str | bytes, *, max_bytes: int = 64 * 1024 * 1024) -> Any:
    """One text message of the server; for programs and tests."""
    return _parse(SERVER_MESSAGES, text, max_bytes)


def parse_picture(data: bytes) -> tuple[PictureHeader, bytes]:
    """One binary message: header and payload. The payload must begin as its codec does."""
    fields, payload = split_picture(data)
    header = decode_fields(PictureHeader, fields, "picture")
    magic = b"\xff\xd8\xff" if header.codec == "jpeg" else b"\x89PNG\r\n\x1a\n"
    if not payload.startswith(magic):
        raise ProtocolError(f"a picture's payload is no {header.codec.upper()}", code="protocol.picture")
    if header.outline is not None:
        _outline_places(payload, header.outline.num_bytes)
    return header, payload


def split_outline(header: PictureHeader, payload: bytes) -> tuple[bytes, tuple[tuple[tuple[float, float], ...], ...]]:
    """A payload's picture, and the lines of the outline behind it: columns and rows in pixels of the picture.

    Raises
    ------
    ProtocolError
        ``protocol.picture`` if the outline is longer than the payload, or ends within a line.
    """
    if header.outline is None:
        return payload, ()
    lines = []
    for start, count in _outline_places(payload, header.outline.num_bytes):
        values = struct.unpack_from(f"<{2 * count}H", payload, start)
        lines.append(tuple((c / 16.0, r / 16.0) for c, r in zip(values[::2], values[1::2], strict=True)))
    return payload[: len(payload) - header.outline.num_bytes], tuple(lines)


def _outline_places(payload: bytes, num_bytes: int) -> list[tuple[int, int]]:
    """Where the points of each line begin, and how many they are."""
    at = len(payload) - num_bytes
    if at <= 0:
        raise ProtocolError("a picture's outline leaves no room for the picture", code="protocol.picture")
    places = []
    while at < len(payload):
        count = int.from_bytes(payload[at : at + 2], "little") if at + 2 <= len(payload) else 0
        if count == 0 or at + 2 + 4 * count > len(payload):
            raise ProtocolError("a picture's outline ends within a line", code="protocol.picture")
        places.append((at + 2, count))
        at += 2 + 4 * count
    return places


def encode_message(message: Any) -> str:
    """A message dataclass as JSON text."""
    return json.dumps(to_jsonable(message), allow_nan=False, separators=(",", ":"))
