"""OpenIGTLink messages as bytes, in both directions, without sockets.

Header versions 1 (protocols 1 and 2), 2 and 3 (protocol 3: an extended header and metadata around the content).
References: openigtlink.org, "Protocol v3" and the pages of TRANSFORM, POSITION, QTDATA and IMAGE.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import ProtocolError
from carina.navigate.devices.crc import crc64
from carina.navigate.rotation import rotation_from_wxyz, wxyz_from_rotation

HEADER = struct.Struct(">H12s20sQQQ")
EXTENDED = struct.Struct(">HHII")
MAX_POSE_BYTES = 1 << 16
"""Maximum accepted size in bytes of a message with poses: 1,300 tools of QTDATA."""
MAX_BODY_BYTES = 64 << 20
"""Maximum size in bytes of a message that is skipped; a larger one means that the stream is corrupt."""
POSE_TYPES = {"TRANSFORM", "POSITION", "QTDATA"}
_QT_ELEMENT = struct.Struct(">20sBB7f")
_PYIGTL_POINT = struct.Struct(">64s32s4B3f4ff20s")
_SECOND = 1 << 32


@dataclass(frozen=True, slots=True)
class IgtlPose:
    """Pose of a tracked tool, as an OpenIGTLink message states it.

    Parameters
    ----------
    name
        The message's device, or the tool of a QTDATA element.
    time_s
        The sender's clock; 0 if the message has no time.
    position_mm
        mm, in the sender's space.
    orientation_wxyz
        ``sender_from_tool``, as sent: of any length.
    """

    name: str
    time_s: float
    position_mm: tuple[float, float, float]
    orientation_wxyz: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class IgtlRequest:
    """Request of a peer: ``GET_IMAGE``, ``GET_TRANSFORM``."""

    what: str
    name: str


class IgtlStream:
    """Parser that turns received bytes into messages; invalid messages are counted and skipped.

    A wrong checksum or content invalidates one message, since the position of the next header is known. An invalid
    header corrupts the stream: the connection has to be opened again.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skip = 0
        self.num_bad: Counter[str] = Counter()
        self.num_skipped = 0
        """Number of received messages of types that contain no pose, which were skipped."""

    def feed(self, data: bytes) -> list[IgtlPose | IgtlRequest]:
        """Return the messages that are complete after these bytes.

        Raises
        ------
        ProtocolError
            ``protocol.igtl``: if the stream is not OpenIGTLink, or has a length that no message has.
        """
        found: list[IgtlPose | IgtlRequest] = []
        self._buffer += data
        while True:
            if self._skip:
                dropped = min(self._skip, len(self._buffer))
                del self._buffer[:dropped]
                self._skip -= dropped
                if self._skip:
                    return found
            if len(self._buffer) < HEADER.size:
                return found
            version, kind_bytes, name_bytes, stamp, num_bytes, checksum = HEADER.unpack_from(self._buffer)
            kind = _text(kind_bytes)
            if version not in {1, 2, 3} or not kind:
                raise ProtocolError(
                    f"expected an OpenIGTLink header with version 1, 2 or 3 and a type; found version {version}, "
                    f"type {kind!r}",
                    code="protocol.igtl",
                )
            if num_bytes > MAX_BODY_BYTES:
                raise ProtocolError(
                    f"an OpenIGTLink message of type {kind} claims {num_bytes} bytes; expected at most "
                    f"{MAX_BODY_BYTES}",
                    code="protocol.igtl",
                )
            if kind.startswith("GET_") and num_bytes <= MAX_POSE_BYTES:
                if len(self._buffer) < HEADER.size + num_bytes:
                    return found
                found.append(IgtlRequest(kind, _text(name_bytes) or ""))
                del self._buffer[: HEADER.size + num_bytes]
                continue
            if kind not in POSE_TYPES or num_bytes > MAX_POSE_BYTES:
                if kind in POSE_TYPES:
                    self.num_bad["wrong pose length"] += 1
                else:
                    self.num_skipped += 1
                del self._buffer[: HEADER.size]
                self._skip = num_bytes
                continue
            if len(self._buffer) < HEADER.size + num_bytes:
                return found
            body = bytes(self._buffer[HEADER.size : HEADER.size + num_bytes])
            del self._buffer[: HEADER.size + num_bytes]
            if crc64(body) != checksum:
                self.num_bad["wrong checksum"] += 1
                continue
            try:
                found += _poses(kind, _text(name_bytes) or "", stamp / _SECOND, _content(version, body))
            except (struct.error, ValueError):
                self.num_bad["malformed content"] += 1


def _text(data: bytes) -> str | None:
    """Return ASCII text up to the first zero byte; None for bytes that are not ASCII."""
    text = data.split(b"\0", 1)[0].rstrip(b" ")
    try:
        decoded = text.decode("ascii")
    except UnicodeDecodeError:
        return None
    return decoded if decoded.isprintable() else None


def _content(version: int, body: bytes) -> bytes:
    """Return the content of a message: the bytes between the extended header and the metadata."""
    if version < 2:
        return body
    size, num_metadata_header, num_metadata, _ = EXTENDED.unpack_from(body)
    end = len(body) - num_metadata_header - num_metadata
    if not EXTENDED.size <= size <= end:
        raise ValueError("extended header of the wrong size")
    return body[size:end]


def _poses(kind: str, name: str, time_s: float, content: bytes) -> list[IgtlPose]:
    if kind == "TRANSFORM":
        values = struct.unpack(">12f", content)
        rotation = np.array(values[:9], dtype=np.float64).reshape(3, 3).T
        # Nine numbers in float32: a matrix that is not a rotation is rejected, since it has no quaternion.
        if not np.isfinite(rotation).all() or np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-3:
            raise ValueError("not a rotation")
        # The orthonormality test admits only determinants near 1 and -1; -1 is a reflection, not a rotation.
        if np.linalg.det(rotation) < 0.0:
            raise ValueError("a reflection, which is not a rotation")
        return [IgtlPose(name, time_s, _three(values[9:]), wxyz_from_rotation(rotation))]
    if kind == "POSITION":
        if len(content) == 12:
            return [IgtlPose(name, time_s, _three(struct.unpack(">3f", content)), (1.0, 0.0, 0.0, 0.0))]
        if len(content) == 24:
            # The short form omits w, which is then not negative.
            values = struct.unpack(">6f", content)
            w = math.sqrt(max(0.0, 1.0 - sum(v * v for v in values[3:])))
            return [IgtlPose(name, time_s, _three(values[:3]), _wxyz((*values[3:], w)))]
        if content and len(content) % _PYIGTL_POINT.size == 0:
            # pyigtl 0.3 writes POSITION as points with a name; this differs from the standard but is in use.
            points = list(_PYIGTL_POINT.iter_unpack(content))
            return [IgtlPose(_text(p[0]) or name, time_s, _three(p[6:9]), _wxyz(p[9:13])) for p in points]
        values = struct.unpack(">7f", content)
        return [IgtlPose(name, time_s, _three(values[:3]), _wxyz(values[3:]))]
    found = []
    for tool, _, _, *numbers in _QT_ELEMENT.iter_unpack(content):
        found.append(IgtlPose(_text(tool) or name, time_s, _three(numbers[:3]), _wxyz(numbers[3:])))
    return found


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)


def _wxyz(values: Sequence[float]) -> tuple[float, float, float, float]:
    """Return a quaternion in the order wxyz, from the OpenIGTLink order x, y, z, w."""
    x, y, z, w = values
    return float(w), float(x), float(y), float(z)


# ------------------------------------------------------------ packing


def pack_message(kind: str, name: str, content: bytes, *, time_s: float = 0.0, version: int = 1) -> bytes:
    """Return the bytes of a complete OpenIGTLink message: header, content and checksum.

    Parameters
    ----------
    kind, name
        At most 12 and 20 ASCII characters; longer names are cut.
    content
        Content without extended header.
    time_s
        Seconds since 1970 (or another epoch), 0 for none.
    version
        Version of the header: 1, or 2 with an extended header without metadata.
    """
    body = content if version < 2 else EXTENDED.pack(EXTENDED.size, 0, 0, 0) + content
    header = HEADER.pack(
        version,
        kind.encode("ascii", "replace")[:12],
        name.encode("ascii", "replace")[:20],
        int(time_s * _SECOND),
        len(body),
        crc64(body),
    )
    return header + body


def pack_transform(name: str, matrix: NDArray[np.float64], *, time_s: float = 0.0, version: int = 1) -> bytes:
    """Return a TRANSFORM message: a 4x4 rigid matrix, mm."""
    content = struct.pack(">12f", *matrix[:3, :3].T.ravel(), *matrix[:3, 3])
    return pack_message("TRANSFORM", name, content, time_s=time_s, version=version)


def pack_position(name: str, pose: IgtlPose, *, version: int = 1) -> bytes:
    """Return a POSITION message: three coordinates and a quaternion."""
    w, x, y, z = pose.orientation_wxyz
    content = struct.pack(">7f", *pose.position_mm, x, y, z, w)
    return pack_message("POSITION", name, content, time_s=pose.time_s, version=version)


def pack_qtdata(name: str, poses: list[IgtlPose], *, time_s: float = 0.0, version: int = 1) -> bytes:
    """Return a QTDATA message: several tools at one time (type 1: a tracker's tool)."""
    content = b""
    for pose in poses:
        w, x, y, z = pose.orientation_wxyz
        content += _QT_ELEMENT.pack(pose.name.encode("ascii", "replace")[:20], 1, 0, *pose.position_mm, x, y, z, w)
    return pack_message("QTDATA", name, content, time_s=time_s, version=version)


def pack_image(
    name: str, pixels: NDArray[np.uint8], *, time_s: float = 0.0, mm_per_px: float = 1.0, version: int = 1
) -> bytes:
    """Return an IMAGE message: a picture ``(height, width, 3)`` uint8 as one slice, unrelated to the patient."""
    height, width, num_components = pixels.shape
    matrix = np.diag([mm_per_px, mm_per_px, mm_per_px])
    # Columns along i, j, k, then the centre of the image.
    numbers = [*matrix.T.ravel(), 0.0, 0.0, 0.0]
    content = struct.pack(">HBBBB3H", 1, num_components, 3, 2, 1, width, height, 1)
    content += struct.pack(">12f", *numbers) + struct.pack(">6H", 0, 0, 0, width, height, 1)
    return pack_message("IMAGE", name, content + pixels.tobytes(), time_s=time_s, version=version)


def pose_matrix(pose: IgtlPose) -> NDArray[np.float64]:
    """Return the pose of a tool as a 4x4 matrix, mm."""
    length = math.sqrt(sum(v * v for v in pose.orientation_wxyz))
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_wxyz([v / length for v in pose.orientation_wxyz])
    matrix[:3, 3] = pose.position_mm
    return matrix
