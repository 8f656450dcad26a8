"""Widget with linked views of a case: the kernel renders, and messages of the notebook carry pictures and gestures.

The widget uses only the connection between page and kernel, so it works for a kernel on another machine, too. The page
sends at most one request at a time; movements in the meantime are added up (``case_view.js``).
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from carina import commands as c
from carina.argument_checks import check_arguments, file_path, flag, instance, pixels, shown
from carina.errors import CarinaError, UsageError, refuse_pickle
from carina.installation import extra_command
from carina.render import LEAD_VIEW, VIEWS, Picture, view_row
from carina.render.saved_picture import PictureMarks
from carina.session import Case
from carina.session.core import Event
from carina.session.scene.branch_names import finish_case_picture
from carina.session.state.snapshot import Changed
from carina.track.tree.branch_labels import branch_label
from carina.volume import Volume, badges_of
from carina.volume.anatomical_planes import PLANES

__all__ = ["CaseView", "show"]

logger = logging.getLogger(__name__)

DEFAULT_VIEWS = (LEAD_VIEW, *PLANES)
MAX_VIEWS = 6
MAX_ACTIONS = 100
"""Maximum number of the user's actions in one request of the notebook; later actions are ignored."""
PIXELS = (32, 2048)
"""Minimum and greatest width and height in pixels of a picture of the view."""
MOVING_QUALITY, STILL_QUALITY = 80, 95
MAX_TURN_RAD, MAX_ADVANCE_MM, MAX_SLICES = math.pi, 200.0, 200
"""Maximum movement of the tip in mm, and maximum number of slices, in one request."""


@check_arguments(source=file_path(also=(Volume, Case)), height_px=pixels())
def show(
    source: str | Path | Volume | Case,
    *,
    views: Sequence[str] = DEFAULT_VIEWS,
    height_px: int = 640,
) -> CaseView:
    """Show linked views of a CT or a case in a notebook, and fly through its airways with mouse and keyboard.

    The kernel renders the pictures, so the notebook can show a case of another machine. If `source` is a path whose
    case is open in a window, the notebook joins this window (:meth:`carina.Case.open`).

    Parameters
    ----------
    source
        A file, a folder, an open volume, a case file ``NAME.carina``, or an open case.
    views
        Names of one to six views, such as ``airway``, ``coronal``, ``tree`` or ``cut-plane``.
    height_px
        Height of all views together in CSS pixels.

    Returns
    -------
    CaseView
        The widget. A notebook displays it as the last value of a cell.

    Raises
    ------
    UsageError
        ``notebook.no-anywidget`` if the package anywidget is not installed; also for an unknown view.
    VolumeImportError
        If the CT or the case file cannot be opened.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> view = carina.show(phantom.volume, views=["airway", "coronal"], height_px=400)  # doctest: +SKIP
    >>> view.case.airways.tree.root.name  # doctest: +SKIP
    'Trachea'
    >>> view.close()  # doctest: +SKIP
    """
    names = _checked_views(views)
    widget_class = _widget_class()
    is_own = not isinstance(source, Case)
    case = source if isinstance(source, Case) else Case.open(source)
    try:
        return CaseView(case, widget_class, views=names, height_px=height_px, closes_case=is_own)
    except BaseException:
        if is_own:
            case.close()
        raise


class CaseView:
    """Linked views of a case in a notebook; `carina.show` creates one.

    Drag in the airway view to look around, turn the wheel to move forward and back, click in a slice to show that point
    in all slices, double-click to move the tip there. The keys are listed below the views.
    """

    @check_arguments(case=instance(Case, "open one with carina.Case.open"), closes_case=flag)
    def __init__(
        self, case: Case, widget_class: Callable[..., Any], *, views: tuple[str, ...], height_px: int, closes_case: bool
    ) -> None:
        self._case = case
        self._closes_case = closes_case
        self._views = views
        self._pictures: dict[str, Picture] = {}
        self._lock = threading.Lock()
        self._answering_thread: int | None = None
        self._has_changed = False
        """Whether another thread changed the case while a request was answered."""
        self._is_closed = False
        layout = [{"view": name, "title": VIEWS[name].title, "is_plane": VIEWS[name].pick == "plane"} for name in views]
        self._widget = widget_class(views=layout, height=height_px)
        self._widget.on_msg(self._on_message)
        self._unsubscribe = case._session.subscribe(self._on_event)

    def __repr__(self) -> str:
        """Return the names of the views and the state of the case, without any text of the CT."""
        state = "closed" if self._is_closed else repr(self._case)
        return f"CaseView({', '.join(self._views)}; {state})"

    def __reduce__(self) -> Any:
        """Raise an error, because the views belong to the notebook of this process."""
        refuse_pickle(self, "call carina.show in the other process")

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self._widget._repr_mimebundle_(**options)

    @property
    def case(self) -> Case:
        """The case; its commands change the views at once."""
        return self._case

    @property
    def widget(self) -> Any:
        """The ``anywidget.AnyWidget``, for layouts with other widgets of ipywidgets."""
        return self._widget

    def close(self) -> None:
        """Remove the views from the notebook, and close the case if `carina.show` opened it."""
        if self._is_closed:
            return
        self._is_closed = True
        self._unsubscribe()
        self._widget.close()
        if self._closes_case:
            self._case.close()

    # ------------------------------------------------------------ messages

    def _on_event(self, event: Event) -> None:
        """Request new pictures from the page after a change that another cell or window has made."""
        if not isinstance(event, Changed) or self._is_closed or self._answering_thread == threading.get_ident():
            return
        self._has_changed = True
        if self._answering_thread is None:
            self._widget.send({"kind": "changed"})

    def _on_message(self, _widget: Any, content: Any, _buffers: Any) -> None:
        """Execute the gestures of a request, and answer with pictures of all views."""
        if self._is_closed or not isinstance(content, Mapping):
            return
        with self._lock:
            self._answering_thread, self._has_changed = threading.get_ident(), False
            try:
                problem = self._execute(content)
                rows, data = self._render_all(content)
                line, badges = self._status_line(), self._badges()
            except CarinaError as error:
                rows, data, problem, line, badges = [], [], str(error), "", []
            except Exception as error:
                # The page sends nothing more until it has an answer.
                logger.exception("could not show the views of a case in a notebook")
                problem = f"internal error in Carina ({type(error).__name__})"
                rows, data, line, badges = [], [], "", []
            finally:
                self._answering_thread = None
        answer = {"number": content.get("number"), "views": rows, "line": line, "badges": badges, "problem": problem}
        self._widget.send({"kind": "pictures", **answer}, data)
        if self._has_changed:
            self._widget.send({"kind": "changed"})

    def _execute(self, content: Mapping[str, Any]) -> str | None:
        """Execute the movements and actions of a request; return the message of the first error."""
        try:
            move = _numbers(content.get("move"), 4)
            if move is not None and any(move):
                turns = [float(np.clip(turn, -MAX_TURN_RAD, MAX_TURN_RAD)) for turn in move[1:]]
                advance_mm = float(np.clip(move[0], -MAX_ADVANCE_MM, MAX_ADVANCE_MM))
                self._case.do(c.Steer(advance_mm, *turns))
            actions = content.get("actions")
            for action in actions[:MAX_ACTIONS] if isinstance(actions, list) else ():
                self._act(action)
        except CarinaError as error:
            return str(error)
        return None

    def _act(self, action: Any) -> None:
        kind = action.get("kind") if isinstance(action, Mapping) else None
        simple = {"next_fork": c.NextFork, "previous_fork": c.PreviousFork, "undo": c.Undo, "redo": c.Redo}
        if kind in simple:
            self._case.do(simple[kind]())
        elif kind == "follow":
            self._case.do(c.SetCrosshair(None))
        elif kind in {"point", "place"}:
            picture = self._pictures.get(str(action.get("view")))
            place = _numbers(action.get("pixel"), 2)
            if picture is None or picture.lps_from_pixel is None or place is None:
                return
            lps = picture.lps_from_pixel @ np.array([*place, 0.0, 1.0])
            point = (float(lps[0]), float(lps[1]), float(lps[2]))
            self._case.do(c.SetCrosshair(point) if kind == "point" else c.Place(point))
            if kind == "place":
                self._case.do(c.SetCrosshair(None))
        elif kind == "slices":
            self._move_slice(str(action.get("view")), _numbers(action.get("steps"), 1))
        else:
            raise UsageError(f"the notebook sent an unknown action: {shown(kind)}", code="notebook.action")

    def _move_slice(self, view: str, steps: Sequence[float] | None) -> None:
        """Move the point that the slices show along the normal of a slice, by a number of voxels."""
        picture = self._pictures.get(view)
        if picture is None or picture.lps_from_pixel is None or not steps:
            return
        volume = self._case.volume
        normal = picture.lps_from_pixel[:3, 2] / np.linalg.norm(picture.lps_from_pixel[:3, 2])
        spacing_mm = 1.0 / np.linalg.norm(np.linalg.inv(volume.lps_from_ijk[:3, :3]) @ normal)
        number = float(np.clip(steps[0], -MAX_SLICES, MAX_SLICES))
        point = self._shown_lps() + number * spacing_mm * normal
        if volume.contains_lps(point):
            self._case.do(c.SetCrosshair((float(point[0]), float(point[1]), float(point[2]))))

    def _shown_lps(self) -> NDArray[np.float64]:
        scene = self._case._session.scene()
        return np.array(self._case.pose.position_lps if scene is None else scene.shown_lps, dtype=np.float64)

    # ------------------------------------------------------------ pictures

    def _render_all(self, content: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[bytes]]:
        """Render all views in the sizes of a request; return their descriptions and their JPEG data."""
        sizes = content.get("sizes")
        is_still = bool(content.get("still", True))
        rows: list[dict[str, Any]] = []
        data: list[bytes] = []
        document = self._case.state.document
        shown_lps, tip_lps = self._shown_lps(), np.array(self._case.pose.position_lps)
        for name in self._views:
            size = _numbers(sizes.get(name) if isinstance(sizes, Mapping) else None, 2)
            if size is None:
                continue
            width, height = (int(np.clip(number, *PIXELS)) for number in size)
            try:
                picture = self._case.render(name, width=width, height=height)
            except CarinaError as error:
                rows.append({"view": name, "problem": str(error)})
                data.append(b"")
                continue
            self._pictures[name] = picture
            is_plane = VIEWS[name].pick == "plane"
            marked = finish_case_picture(
                picture,
                PictureMarks(letters=VIEWS[name].lettered or is_plane, scale=is_still, names=is_still),
                volume=self._case.volume,
                airways=None if document is None else document.airways,
                route=None if document is None else document.route,
                tip_lps=tip_lps,
            )
            crosshair = picture.pixel_of(shown_lps) if is_plane else None
            rows.append({"view": name, "width": width, "height": height, "crosshair": crosshair, "problem": None})
            data.append(_jpeg(marked.rgb, full=is_still))
        return rows, data

    def _badges(self) -> list[str]:
        """Return the permanent notes about the CT and its airways."""
        document = self._case.state.document
        airways = None if document is None else document.airways
        notes = (*badges_of(self._case.volume), *getattr(airways, "badges", ()))
        return [note.words for note in dict.fromkeys(notes)]

    def _status_line(self) -> str:
        """Return the name of the tip's branch and its diameter."""
        info = self._case._session.pose_info()
        if info is None:
            return ""
        if info.branch is None:
            return "outside the airways"
        width = "" if info.lumen_mm is None else f", {info.lumen_mm:.1f} mm wide"
        return f"{branch_label(info.branch)}{width}"


def _checked_views(views: Any) -> tuple[str, ...]:
    names = (views,) if isinstance(views, str) else views
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        expected = "names of views, such as ['airway', 'tree']"
        raise UsageError(f"show: views: expected {expected}; found {shown(views)}", code="usage.type")
    if not 1 <= len(names) <= MAX_VIEWS:
        raise UsageError(f"show: views: expected one to {MAX_VIEWS} names of views; found {len(names)}")
    found = tuple(view_row(name).name for name in names)
    if len(set(found)) != len(found):
        raise UsageError(f"show: views: expected different views; found {', '.join(found)}")
    return found


def _widget_class() -> Callable[..., Any]:
    """Return the class of the widget.

    Raises
    ------
    UsageError
        ``notebook.no-anywidget`` if anywidget is not installed.
    """
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise UsageError(
            f"views in a notebook need the package anywidget; run: {extra_command('notebook')}",
            code="notebook.no-anywidget",
        ) from None
    folder = Path(__file__).parent
    return type(
        "CaseViewWidget",
        (anywidget.AnyWidget,),
        {
            "_esm": (folder / "case_view.js").read_text(encoding="utf-8"),
            "_css": (folder / "case_view.css").read_text(encoding="utf-8"),
            "views": traitlets.List().tag(sync=True),
            "height": traitlets.Int(640).tag(sync=True),
        },
    )


def _numbers(value: Any, count: int) -> tuple[float, ...] | None:
    """Return a list of finite numbers from a message; None if it is missing or no such list."""
    if not isinstance(value, list | tuple) or len(value) != count:
        return None
    if not all(isinstance(one, int | float) and math.isfinite(one) for one in value):
        return None
    return tuple(float(one) for one in value)


def _jpeg(rgb: NDArray[np.uint8], *, full: bool) -> bytes:
    quality = STILL_QUALITY if full else MOVING_QUALITY
    data: bytes = simplejpeg.encode_jpeg(
        np.ascontiguousarray(rgb), quality=quality, colorspace="RGB", colorsubsampling="444" if full else "420"
    )
    return data
