"""Readers of OpenCV camera calibrations: YAML, XML or JSON, from ``cv2.calibrateCamera`` or ``cv2.fisheye``.

The readers accept the output of `cv::FileStorage` and ROS's ``camera_info`` files only: no tags that create objects, no
entities, no anchors. The names of the entries differ between OpenCV's own samples; all of these names are accepted, in
upper or lower case.
"""

from __future__ import annotations

import json
import math
import os
import re
from typing import TYPE_CHECKING, Any

from carina.disk import open_regular
from carina.errors import CarinaError, RenderError, VolumeImportError
from carina.scopes.lens import Calibration, Lens

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_BYTES = 1_000_000
MATRIX_KEYS = ("camera_matrix", "cameramatrix", "intrinsic_matrix", "k", "mtx", "m1")
COEFFICIENT_KEYS = (
    "distortion_coefficients",
    "distortioncoefficients",
    "dist_coeffs",
    "dist_coeff",
    "distcoeffs",
    "d",
    "dist",
    "d1",
)
SIZE_KEYS = ("image_size", "imagesize", "resolution")
WIDTH_KEYS, HEIGHT_KEYS = ("image_width", "width"), ("image_height", "height")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?\.?(?:nan|inf)\b", re.IGNORECASE)
Entries = dict[str, Any]


def lens_from_file(path: str | os.PathLike[str]) -> Lens:
    """Read a camera calibration.

    Parameters
    ----------
    path
        ``.yml``, ``.yaml``, ``.xml`` or ``.json`` as ``cv2.FileStorage`` writes them, with ``camera_matrix``,
        ``distortion_coefficients``, ``image_width`` and ``image_height`` (other common names are accepted). The model
        is OpenCV's default with 4, 5 or 8 coefficients, or that of ``cv2.fisheye`` if the file contains
        ``fisheye_model: 1`` or ``distortion_model: fisheye``.

    Returns
    -------
    Lens
        Lens with its own field of view, for pictures of the calibration's proportions.

    Raises
    ------
    VolumeImportError
        If the file cannot be read or is not such a calibration; the message names the missing part.
    """
    try:
        with open_regular(path) as file:
            data = file.read(MAX_BYTES + 1)
    except VolumeImportError:
        raise  # The error states that the path is not a regular file; it needs no translation.
    except OSError as error:
        raise VolumeImportError(f"{path}: cannot be read: {error.strerror}", code="render.lens") from error
    if len(data) > MAX_BYTES:
        raise VolumeImportError(f"{path}: too large for a camera calibration", code="render.lens")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise VolumeImportError(
            f"{path}: not a text file; expected a camera calibration", code="render.lens"
        ) from error
    try:
        return lens_from_text(text)
    except CarinaError as error:
        # The invalid value comes from the file, not from an argument, so the error names the file.
        raise VolumeImportError(f"{path}: {error}", code="render.lens") from error


def lens_from_text(text: str) -> Lens:
    """Return the lens of a calibration's text; see :func:`lens_from_file`."""
    start = text.lstrip()[:1]
    try:
        if start == "<":
            entries = _read_xml(text)
        elif start == "{":
            entries = _read_json(text)
        else:
            entries = _read_yaml(text)
    except RecursionError as error:
        raise _calibration_error("its entries are nested too deeply") from error
    return _lens({key.lower(): value for key, value in entries.items()})


def _calibration_error(words: str) -> VolumeImportError:
    return VolumeImportError(f"reading a camera calibration: {words}", code="render.lens")


# ------------------------------------------------------------ readers of the three file formats


def _read_json(text: str) -> Entries:
    try:
        value = json.loads(text)
    except ValueError as error:
        raise _calibration_error(f"it is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise _calibration_error("expected one JSON object")
    return value


def _read_xml(text: str) -> Entries:
    # Entities can expand a small file without limit; OpenCV writes none.
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise _calibration_error("expected OpenCV's XML, found a document type declaration or entities")
    import xml.etree.ElementTree as ET  # Imported here because the module is slow to load and few calibrations are XML.

    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise _calibration_error(f"it is not valid XML: {error}") from error
    return {child.tag: _xml_value(child) for child in root}


def _xml_value(node: Element) -> Any:
    if len(node):
        return {child.tag: (child.text or "").strip() for child in node}
    return (node.text or "").strip()


def _read_yaml(text: str) -> Entries:
    """Read the top-level entries of OpenCV's YAML: scalars, lists, and matrices as maps of scalars and one list."""
    entries: Entries = {}
    inner: Entries | None = None
    lines = text.splitlines()
    n = 0
    while n < len(lines):
        line = lines[n].split(" #")[0].rstrip()
        n += 1
        if not line.strip() or line.startswith(("%", "---", "...", "#")):
            continue
        match = re.fullmatch(r"(\s*)([\w-]+)\s*:\s*(.*)", line)
        if match is None:
            raise _calibration_error(f"expected OpenCV's YAML, found {line.strip()[:60]!r} on line {n}")
        indent, key, value = match.groups()
        if value.startswith("["):
            # A list may continue over several lines.
            depth = value.count("[") - value.count("]")
            while depth > 0 and n < len(lines):
                part = lines[n].strip()
                depth += part.count("[") - part.count("]")
                value += " " + part
                n += 1
            if depth != 0:
                raise _calibration_error(f"the list of {key!r} has no closing bracket")
        if indent and inner is not None:
            inner[key] = value
        elif value in {"", "!!opencv-matrix"}:
            inner = entries.setdefault(key, {})
        else:
            inner, entries[key] = None, value
    return entries


# ------------------------------------------------------------ lens from the entries of a calibration


def _numbers(what: str, value: Any) -> list[float]:
    """Return the numbers of a matrix entry in any of the three formats, row by row."""
    if isinstance(value, dict):
        data = {key.lower(): entry for key, entry in value.items()}
        if "data" not in data:
            raise _calibration_error(f"{what} has no data")
        found = _numbers(what, data["data"])
        sides = [data.get("rows"), data.get("cols")]
        if None not in sides:
            rows, cols = (
                _whole_number(f"{what}'s {name}", side) for name, side in zip(("rows", "cols"), sides, strict=True)
            )
            if rows * cols != len(found):
                raise _calibration_error(f"{what}: expected {rows} x {cols} numbers, found {len(found)}")
        return found
    if isinstance(value, bool) or value is None:
        raise _calibration_error(f"{what}: expected numbers, found {value}")
    if isinstance(value, int | float):
        return [float(value)]
    if isinstance(value, list):
        return [number for entry in value for number in _numbers(what, entry)]
    rest = NUMBER.sub(" ", str(value))
    if re.sub(r"[\s,\[\]]", "", rest):
        raise _calibration_error(f"{what}: expected numbers, found {str(value)[:60]!r}")
    return [float(text.lower().replace(".n", "n").replace(".i", "i")) for text in NUMBER.findall(str(value))]


def _finite_number(what: str, value: Any) -> list[float]:
    found = _numbers(what, value)
    wrong = [number for number in found if not math.isfinite(number)]
    if wrong:
        raise _calibration_error(f"{what}: expected finite numbers, found {wrong[0]}")
    return found


def _whole_number(what: str, value: Any) -> int:
    found = _finite_number(what, value)
    if len(found) != 1 or found[0] != int(found[0]) or not 1 <= found[0] <= 1 << 20:
        raise _calibration_error(f"{what}: expected a whole number from 1 to 1048576, found {value}")
    return int(found[0])


def _first_entry(entries: Entries, keys: tuple[str, ...]) -> Any:
    return next((entries[key] for key in keys if key in entries), None)


def _lens(entries: Entries) -> Lens:
    matrix, coefficients = _first_entry(entries, MATRIX_KEYS), _first_entry(entries, COEFFICIENT_KEYS)
    if matrix is None:
        raise _calibration_error("it has no camera_matrix")
    if coefficients is None:
        raise _calibration_error("it has no distortion_coefficients")
    size = _first_entry(entries, SIZE_KEYS)
    sides = [_first_entry(entries, WIDTH_KEYS), _first_entry(entries, HEIGHT_KEYS)]
    if size is not None:
        sides = list(_finite_number("image_size", size))
    if len(sides) != 2 or None in sides:
        raise _calibration_error(
            "it has no image_width or image_height, so the calibration cannot be scaled to an image"
        )
    width, height = (
        _whole_number(name, side) for name, side in zip(("image_width", "image_height"), sides, strict=True)
    )
    m = _finite_number("camera_matrix", matrix)
    if len(m) != 9:
        raise _calibration_error(f"camera_matrix: expected 3 x 3 numbers, found {len(m)}")
    if m[1] != 0.0 or m[3] != 0.0 or m[6:] != [0.0, 0.0, 1.0]:
        raise _calibration_error(f"camera_matrix: expected fx 0 cx, 0 fy cy, 0 0 1; found {m}")
    if not (m[0] > 0.0 and m[4] > 0.0):
        raise _calibration_error(f"camera_matrix: expected focal lengths above 0 pixels, found {m[0]:g} and {m[4]:g}")
    # OpenCV counts from the centre of the first pixel, Carina from its corner: half a pixel is added.
    centre = (m[2] + 0.5, m[5] + 0.5)
    if not (0.0 <= centre[0] <= width and 0.0 <= centre[1] <= height):
        raise _calibration_error(
            f"camera_matrix: the principal point {m[2]:g}, {m[5]:g} lies outside the image of {width} x {height} pixels"
        )
    known = Calibration((m[0], m[4]), centre, (width, height))
    d = _finite_number("distortion_coefficients", coefficients)
    if _is_fisheye(entries):
        if len(d) != 4:
            raise _calibration_error(
                f"distortion_coefficients: expected k1 to k4 of a fisheye lens, found {len(d)} numbers"
            )
        return _refuse_folding_lens(Lens("fisheye", tuple(d), known))
    # 12 and 14 coefficients describe thin prisms and tilted sensors, which scopes lack: only zeros are accepted.
    if len(d) in {12, 14} and not any(d[8:]):
        d = d[:8]
    if len(d) not in {4, 5, 8}:
        raise _calibration_error(
            f"distortion_coefficients: expected k1 k2 p1 p2 [k3 [k4 k5 k6]], found {len(d)} numbers"
        )
    return _refuse_folding_lens(Lens("brown", (*d, *(0.0,) * (8 - len(d))), known))


def _refuse_folding_lens(lens: Lens) -> Lens:
    """Reject a lens that cannot render a picture because its model folds back inside the image circle."""
    assert lens.calibration is not None
    width, height = lens.calibration.size_px
    scale = max(1.0, max(width, height) / 4096)
    try:
        lens.optics(max(1, round(width / scale)), max(1, round(height / scale)))
    except RenderError as error:
        raise _calibration_error(str(error)) from error
    return lens


def _is_fisheye(entries: Entries) -> bool:
    model = str(entries.get("distortion_model", entries.get("camera_model", ""))).strip("\"' ").lower()
    if model in {"fisheye", "equidistant", "kannala-brandt", "kannala_brandt", "opencv_fisheye"}:
        return True
    if model not in {"", "plumb_bob", "rational_polynomial", "pinhole", "brown", "opencv", "radtan"}:
        raise _calibration_error(
            f"distortion_model: expected plumb_bob, rational_polynomial or fisheye, found {model!r}"
        )
    marked = entries.get("fisheye_model")
    return marked is not None and _finite_number("fisheye_model", marked)[:1] not in ([], [0.0])
