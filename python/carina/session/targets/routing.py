"""Commands for targets and routes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from carina import commands as c
from carina.case.document import Lesion, Target
from carina.case.routes import ChosenRoute, route_to_branch
from carina.case.scope_choice import document_with_lesion
from carina.display import one_line
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan.targets.doubts import BESIDE_AIRWAY
from carina.scopes import WallField
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase
from carina.session.state.snapshot import UserMessage
from carina.session.targets.retrack import NO_START, needed_target, searched_target, tracked_target

IN_LUMEN_MM = 0.05
"""Maximum distance in mm by which a point is moved into the lumen that counts as rounding."""


@one_line
@dataclass(frozen=True, slots=True)
class Mark:
    """Result of a click with the tool *Mark target*, without the click."""

    sentences: tuple[str, ...]
    """Texts: the structure that the click marks, and the reasons for which it may not be a nodule."""
    warns: bool
    """Whether the target mark has warnings, or neither a route nor a plan can lead to the point."""


class RouteHandlers(CommandHandlers):
    """Commands that add and remove targets and choose the route."""

    @does(c.AddTarget)
    def add_target(self, command: c.AddTarget) -> str:
        """Add a target at a point as a job.

        With the cost ``lumen``, a structure at the point that is outside the lumen and denser than lung is segmented as
        a target with a size. The routes to this target are planned (:mod:`carina.session.targets.planning`), and the
        session chooses none of them. Without such a structure, the path through the lumen to the point becomes the
        route. A point at most 5 mm outside the lumen is then moved into the lumen, and the user is notified. A target
        farther away is stored with the reason why it has no path.

        With the costs ``walls`` and ``paper`` the point is not moved, and the path to the point becomes the route.
        """
        case = self.core.needed_case()
        case.check_inside(command.lps)
        if command.root_lps is not None:
            case.check_inside(command.root_lps)
        if command.cost != "lumen" and command.root_lps is None and case.document.airways is None:
            raise UsageError(NO_START, code="track.no-root")
        with self.core.lock:
            number = case.next_number("target")
        target = Target(
            target_id=f"target-{number}",
            name=f"Target {number}",
            lps=command.lps,
            cost=command.cost,
            root_lps=command.root_lps,
        )
        if command.cost != "lumen":
            return self.core.jobs.start(
                f"target {number}", f"finding the path to {target.name}", lambda job: self._search(case, target, job)
            )

        def work(job: Job) -> None:
            lesion, why_none = self._lesion(case, target, job.progress)
            if lesion is not None and not _may_be_airway(lesion):
                with self.core.lock:
                    job.check()
                    changed = document_with_lesion(case.document, replace(target, lesion=lesion))
                    self.core.change(case, f"add {target.name}", changed)
                    self.core.emit(UserMessage(f"{target.name}: {lesion.nodule.words}"))
                return
            tracked, tracked_in = target, None
            while True:
                with self.core.lock:
                    job.check()
                    document = case.document
                    if document.airways is None:
                        msg = f"no path to {target.name} yet: wait for the airways, or mark the trachea"
                        raise NoResultError(msg)
                    if tracked_in is document.airways:
                        if tracked.problem is not None and why_none is not None:
                            problem = f"no nodule was found here: {why_none}. No airway either: {tracked.problem}"
                            tracked = replace(tracked, problem=problem)
                        route = tracked.route or document.route
                        changed = replace(document, targets=(*document.targets, tracked), route=route)
                        self.core.change(case, f"add {target.name}", changed)
                        if tracked.snapped_mm is not None and tracked.snapped_mm > IN_LUMEN_MM:
                            words = f"{target.name} was moved {tracked.snapped_mm:.1f} mm into the nearest lumen"
                            if lesion is not None:
                                words += "; if this is a nodule, choose \u201cSegment as nodule\u201d"
                            self.core.emit(UserMessage(words))
                        elif lesion is not None:
                            words = f"{target.name} is in the lumen; to plan the tissue beside it, click on that tissue"
                            self.core.emit(UserMessage(words))
                        return
                    tracked_in = document.airways
                tracked = tracked_target(tracked_in, target)

        return self.core.jobs.start(f"target {number}", f"finding the path to {target.name}", work)

    @does(c.GrowTarget)
    def grow_target(self, command: c.GrowTarget) -> str:
        """Segment the lesion at the clicked point of a target, and replace the target by it.

        The command confirms that the lesion is not the airway beside it; the user must confirm other doubts.
        """
        case = self.core.needed_case()
        with self.core.lock:
            name = needed_target(case.document, command.target_id).name

        def work(job: Job) -> None:
            with self.core.lock:
                target = needed_target(case.document, command.target_id)
            lesion, why_none = self._lesion(case, target, job.progress)
            if lesion is None:
                raise NoResultError(why_none or f"{name} is in an airway, so there is nothing to segment")
            lesion = replace(lesion, target=replace(lesion.target, confirmed=(BESIDE_AIRWAY,)))
            with self.core.lock:
                job.check()
                document, now = case.document, needed_target(case.document, command.target_id)
                grown = Target(now.target_id, now.name, now.lps, lesion=lesion).described(
                    now.name, now.note, now.priority
                )
                route = document.route
                if route is not None and route.target_id == now.target_id:
                    route = None
                changed = document_with_lesion(document, grown)
                self.core.change(case, f"grow {name}", replace(changed, route=route))

        return self.core.jobs.start(f"grow {command.target_id}", f"growing {name}", work)

    @answers(c.MarkAt)
    def mark_at(self, question: c.MarkAt) -> Mark:
        """Return what a click would mark at a point, by the same segmentation and path as :meth:`add_target`."""
        case = self.core.needed_case()
        case.check_inside(question.lps)
        is_newest = case.planning.begin_mark()

        def progress(_what: str, _share: float | None) -> None:
            if not is_newest():
                raise CancelledError("the cursor has moved")

        airways = case.document.airways
        if airways is not None and case.info.volume.is_hu:
            case.planning.wall_for_marks(airways)
        target = Target(target_id="mark", name="Mark", lps=question.lps)
        lesion, why_none = self._lesion(case, target, progress)
        if lesion is not None and not _may_be_airway(lesion):
            doubts = tuple(f"doubt: {doubt.words}" for doubt in lesion.target.doubts)
            return Mark((f"a click marks a {lesion.nodule.words}", *doubts), warns=bool(doubts))
        if airways is None:
            return Mark(("a click marks nothing yet: wait for the airways, or mark the trachea",), warns=True)
        tracked = tracked_target(airways, target)
        if tracked.problem is not None:
            reasons = (tracked.problem,) if why_none is None else (why_none,)
            return Mark(("a click marks a point without a path", *reasons), warns=True)
        away_mm = tracked.snapped_mm or 0.0
        where = "this place in the airway" if away_mm <= IN_LUMEN_MM else f"the airway, {away_mm:.1f} mm away"
        beside = () if lesion is None else ("\u201cSegment as nodule\u201d then selects the tissue here",)
        return Mark((f"a click marks {where}", *beside), warns=False)

    def _lesion(
        self, case: OpenCase, target: Target, progress: Callable[[str, float | None], None]
    ) -> tuple[Lesion | None, str | None]:
        """Return the lesion at a target, or the reason why none was found; both are None without Hounsfield units."""
        volume, airways = case.info.volume, case.document.airways
        if not volume.is_hu:
            return None, None
        try:
            found = self.core.parts.target_from_click(
                volume,
                target.lps,
                target_id=target.target_id,
                name=target.name,
                airways=airways,
                wall=_wall_at_hand(case),
                progress=progress,
            )
            return Lesion(found), None
        except NoResultError as error:
            return None, None if error.code == "plan.in-airway" else str(error)

    def _search(self, case: OpenCase, target: Target, job: Job) -> None:
        """Add a target with a path that ignores the lumen; its values refer to the airways at the end of the search."""
        searched_in = case.document.airways
        tracked = searched_target(case.info.volume, searched_in, target, progress=job.progress, cancel=job.cancel)
        while True:
            with self.core.lock:
                job.check()
                document = case.document
                if document.airways is searched_in:
                    changed = replace(
                        document, targets=(*document.targets, tracked), route=tracked.route or document.route
                    )
                    self.core.change(case, f"add {target.name}", changed)
                    return
                searched_in = document.airways
            tracked = tracked_target(searched_in, tracked)

    @does(c.RemoveTarget)
    def remove_target(self, command: c.RemoveTarget) -> None:
        """Delete a target, and the present route if it leads to this target."""
        target_id = command.target_id
        case = self.core.needed_case()
        with self.core.lock:
            document = case.document
            target = needed_target(document, target_id)
            left = tuple(t for t in document.targets if t.target_id != target_id)
            route = document.route
            if route is not None and route.target_id == target_id:
                route = None
            self.core.change(case, f"remove {target.name}", replace(document, targets=left, route=route))

    @does(c.ChooseRoute)
    def choose_route(self, command: c.ChooseRoute) -> None:
        """Choose the route to a target or to the end of a branch, or remove the route."""
        target_id, branch_id = command.target_id, command.branch_id
        case = self.core.needed_case()
        with self.core.lock:
            document = case.document
            route: ChosenRoute | None = None
            if target_id is not None:
                target = needed_target(document, target_id)
                if target.route is None:
                    raise NoResultError(f"no path to {target.name}: {target.problem}")
                route = target.route
            elif branch_id is not None:
                if document.airways is None or all(b.id != branch_id for b in document.airways.tree.branches):
                    raise UsageError(f"the tree has no branch {branch_id}", code="session.branch")
                route = route_to_branch(document.airways.tree, branch_id)
            label = "remove the route" if route is None else f"route to {route.title}"
            self.core.change(case, label, replace(document, route=route))


def _may_be_airway(lesion: Lesion) -> bool:
    """Return whether the point of a lesion may select the airway beside the lesion.

    The wall and the vessel next to an airway are denser than lung, as nodules are. The path to the airway is then the
    default, and the user can select the lesion with one more click.
    """
    return any(doubt.code == BESIDE_AIRWAY for doubt in lesion.target.doubts)


def _wall_at_hand(case: OpenCase) -> WallField | None:
    """Return the wall field of the document's airways if it is already computed, else None.

    The segmentation of a target computes a missing wall, so that the result does not depend on earlier jobs.
    """
    airways, made = case.document.airways, case.planning.made
    if made is not None and made.airways is airways:
        wall: WallField = made.wall
        return wall
    held = case.wall.of(airways)
    if held is not None:
        return held.field
    return None if airways is None else case.planning.wall_of(airways)
