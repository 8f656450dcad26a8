"""Commands for targets with a size: planning of routes, choice of a route, and maps of the lungs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from carina import commands as c
from carina.case.document import Document, Target
from carina.case.routes import NeedleLine, route_to_parking
from carina.case.scope_choice import document_with_scope
from carina.errors import NoResultError, UsageError
from carina.plan import needle_to_target_mm, tool
from carina.plan.report import PlanMaterials
from carina.scopes import scope_preset
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.derived.lungs import LungsInfo
from carina.session.derived.plans import PlannedTarget, PlanningInfo, carina_depth_mm, chosen_number
from carina.session.flights.tip_commands import place_pose
from carina.session.open_case.open_case import OpenCase, as_point
from carina.session.targets.ct_location import dicom_problem
from carina.session.targets.retrack import needed_target

if TYPE_CHECKING:
    from carina.track import Airways


class PlanHandlers(CommandHandlers):
    """Commands of the steps *Target* and *Route* for targets outside the airways."""

    def follow(self, case: OpenCase) -> None:
        """Request plans and lung maps for the present document; the caller holds the session's lock."""
        case.planning.follow(case.document)
        case.planning.lungs.follow(case.document)
        self.core.changed("plan", "lungs")

    @does(c.MapLungs)
    def map_lungs(self, _command: c.MapLungs) -> None:
        """Map the lungs around the targets as a job; a stopped or failed job is repeated."""
        case = self.core.needed_case()
        with self.core.lock:
            case.planning.lungs.map_lungs(_airways_of(case))

    @does(c.MapReach)
    def map_reach(self, command: c.MapReach) -> None:
        """Map the reach of one instrument as a job; a stopped or failed job is repeated."""
        scope_preset(command.scope)
        tool(command.tool)
        case = self.core.needed_case()
        with self.core.lock:
            case.planning.lungs.map_reach(_airways_of(case), command.scope, command.tool)

    @answers(c.LungsOf)
    def lungs_of(self, _question: c.LungsOf) -> LungsInfo:
        """Return the maps of the lungs that are available."""
        with self.core.lock:
            return self.core.needed_case().planning.lungs.info()

    @does(c.SetPlanOptions)
    def set_plan_options(self, command: c.SetPlanOptions) -> None:
        """Set the options of a target's plan and plan its routes again; a chosen route remains chosen.

        The scope is one setting of the case: another scope is also that of the airway view and of the other plans.
        """
        scope_preset(command.scope)
        tool(command.tool)
        case = self.core.needed_case()
        with self.core.lock:
            document, target = case.document, needed_target(case.document, command.target_id)
            if target.lesion is None:
                raise UsageError(f"{target.name} lies in the airways: there is no needle to plan", code="plan.target")
            named = {name: getattr(command, name) for name in c.PlanOptions.__struct_fields__}
            options = c.PlanOptions(**named)
            if options.movement is not None and options.moved_mm is not None:
                raise UsageError(
                    "the movement of a target is either entered or measured; leave one of them out", code="plan.range"
                )
            if options == target.lesion.options:
                case.planning.again()
                return
            changed = with_target(document, replace(target, lesion=replace(target.lesion, options=options)))
            if options.scope != target.lesion.options.scope:
                changed = document_with_scope(changed, options.scope)
            self.core.change(
                case,
                f"plan the way to {target.name}",
                changed,
                gesture=("plan", target.target_id),
            )

    @does(c.DescribeTarget)
    def describe_target(self, command: c.DescribeTarget) -> None:
        """Set name, note and priority of a target; its route gets the same name."""
        case = self.core.needed_case()
        with self.core.lock:
            document, target = case.document, needed_target(case.document, command.target_id)
            changed = target.described(command.called, command.remark, command.rank)
            if (target.name, target.note, target.priority) == (command.called, command.remark, command.rank):
                return
            chosen = document.route
            if chosen is not None and chosen.target_id == target.target_id:
                chosen = changed.route if chosen is target.route else replace(chosen, title=command.called)
            self.core.change(
                case,
                f"describe {command.called}",
                replace(with_target(document, changed), route=chosen),
                gesture=("describe", target.target_id),
            )

    @does(c.ChoosePlannedRoute)
    def choose_planned_route(self, command: c.ChoosePlannedRoute) -> None:
        """Choose a planned route, which ends at the scope's standing point and includes the line of the needle."""
        case = self.core.needed_case()
        with self.core.lock:
            document, target = case.document, needed_target(case.document, command.target_id)
            planned = None if target.lesion is None else case.planning.of(target.lesion)
            if planned is None or document.airways is None:
                raise NoResultError(
                    f"the routes to {target.name} have not been planned yet: wait for the plan", code="plan.no-plan"
                )
            if planned.plan is None or not planned.plan.routes:
                raise NoResultError(f"{target.name}: {planned.problem}", code="plan.no-route")
            routes = planned.plan.routes
            if command.number > len(routes):
                raise UsageError(
                    f"the plan has {len(routes)} routes to {target.name}; there is no route {command.number}",
                    code="plan.no-route",
                )
            leg = routes[command.number - 1].leg
            needle = NeedleLine((as_point(leg.tip_lps), as_point(leg.aim_lps)), float(leg.to_target_mm))
            route = route_to_parking(document.airways.tree, needle, target.target_id, target.name)
            self.core.change(case, f"route {command.number} to {target.name}", replace(document, route=route))

    @does(c.ChoosePair)
    def choose_pair(self, command: c.ChoosePair) -> None:
        """Choose a route with a scope and a tool; another scope or tool plans the routes again, with this place.

        Another scope is also that of the airway view and of the other plans.
        """
        scope_preset(command.scope)
        tool(command.tool)
        case = self.core.needed_case()
        with self.core.lock:
            document, target = case.document, needed_target(case.document, command.target_id)
            planned = None if target.lesion is None else case.planning.of(target.lesion)
            routes = () if planned is None or planned.plan is None else planned.plan.routes
            route = next((one for one in routes if one.key == command.route), None)
            if planned is None or planned.plan is None or document.airways is None or route is None:
                raise NoResultError(
                    f"the plan of {target.name} has no route {command.route}: wait for the plan, and choose one of its "
                    "routes",
                    code="plan.no-route",
                )
            verdict = next(
                (
                    one
                    for one in case.planning.pairs(None)
                    if (one.scope.name, one.tool, one.route_key) == (command.scope, command.tool, command.route)
                ),
                None,
            )
            assert target.lesion is not None
            options = target.lesion.options
            same = (options.scope, options.tool) == (command.scope, command.tool)
            # Each route of the present plan ends at the parking position of the planned scope.
            needle = NeedleLine((route.leg.tip_lps, route.leg.aim_lps), route.leg.to_target_mm)
            if not same and verdict is not None and verdict.needle_lps is not None:
                needle = NeedleLine(verdict.needle_lps, needle_to_target_mm(planned.plan, verdict))
            chosen = route_to_parking(document.airways.tree, needle, target.target_id, target.name)
            if not same:
                place = c.ChosenPlace(route.branch_id, route.along_mm, route.aim)
                options = msgspec.structs.replace(options, scope=command.scope, tool=command.tool, place=place)
                target = replace(target, lesion=replace(target.lesion, options=options))
            changed = replace(with_target(document, target), route=chosen)
            if command.scope != planned.plan.scope.name:
                changed = document_with_scope(changed, command.scope)
            self.core.change(case, f"{scope_preset(command.scope).title} on the route to {target.name}", changed)

    @does(c.SetAvailableScopes)
    def set_available_scopes(self, command: c.SetAvailableScopes) -> None:
        """Store which scopes are available here, for all cases on this machine."""
        for name in command.scopes or ():
            scope_preset(name)
        with self.core.lock:
            if self.core.store is not None:
                self.core.store.set_available_scopes(command.scopes)
            self.core.changed("plan")

    @does(c.SeeTurn)
    def see_turn(self, command: c.SeeTurn) -> None:
        """Place the tip before a turn of the list, in free movement and level for the operator.

        The view of the fork then agrees with its description in the list of turns.
        """
        case = self.core.needed_case()
        with self.core.lock:
            turns = case.planning.turns()
            if turns is None:
                raise NoResultError("there is no list of turns: choose a planned route first", code="plan.no-route")
            if command.number > len(turns.turns):
                raise UsageError(
                    f"the route has {len(turns.turns)} turns; there is no turn {command.number}", code="plan.range"
                )
            camera = turns.turns[command.number - 1].camera(case.document.look.operator)
            self.core.fly(place_pose(camera))

    @answers(c.CtFolder)
    def ct_folder(self, _question: c.CtFolder) -> Path:
        """Return the path of the folder from which the CT of the open case was read."""
        with self.core.lock:
            case = self.core.needed_case()
            problem = dicom_problem(case)
            if problem is not None or case.planning.origin.place is None:
                raise UsageError(str(problem), code="plan.not-dicom")
            return Path(case.planning.origin.place)

    @answers(c.SeriesFiles)
    def series_files(self, _question: c.SeriesFiles) -> Path | None:
        """Return the path of the files with all series that were found beside the open CT; None if not known."""
        with self.core.lock:
            path = None if self.core.case is None else self.core.case.planning.origin.series_files
            return None if path is None else Path(path)

    @answers(c.PlanningOf)
    def planning_of(self, _question: c.PlanningOf) -> PlanningInfo:
        """Return the plans and verdicts that are available."""
        with self.core.lock:
            case = self.core.needed_case()
            stored = None if self.core.store is None else self.core.store.available_scopes()
            available = case.planning.same_available(stored)
            targets = tuple(
                PlannedTarget(target, case.planning.of(target.lesion))
                for target in case.document.targets
                if target.lesion is not None
            )
            return PlanningInfo(
                targets=targets,
                standing=case.planning.standing(),
                verdicts=case.planning.verdicts(),
                verdicts_standing=case.planning.verdicts_standing(),
                pairs=case.planning.pairs(available),
                pairs_standing=case.planning.pairs_standing(),
                available=available,
                document=case.document,
                turns=case.planning.turns(),
                carm=case.planning.carm(),
                carm_standing=case.planning.carm_standing(),
                dicom_problem=dicom_problem(case),
            )

    @answers(c.PlanToTakeAway)
    def plan_to_take_away(self, question: c.PlanToTakeAway) -> PlanMaterials:
        """Return the material of a plan report for the chosen route, or for the best route if none is chosen."""
        with self.core.lock:
            case = self.core.needed_case()
            document, target = case.document, needed_target(case.document, question.target_id)
            lesion = target.lesion
            made, planned = case.planning.made, None if lesion is None else case.planning.of(lesion)
            if lesion is None or made is None or planned is None or planned.plan is None:
                why = "" if planned is None or planned.problem is None else f": {planned.problem}"
                raise NoResultError(f"{target.name} has no plan yet{why}", code="plan.no-plan")
            mine = document.route is not None and document.route.target_id == target.target_id
            number = chosen_number(document, planned.plan) if mine else None
            return PlanMaterials(
                volume=case.info.volume,
                airways=made.airways,
                wall=made.wall,
                plan=planned.plan,
                route_number=number or 1,
                verdicts=case.planning.verdicts() if number is not None else (),
                operator=document.look.operator,
                carina_depth_mm=carina_depth_mm(lesion.options, planned.plan.routes[(number or 1) - 1])
                if planned.plan.routes
                else None,
                notes=tuple(note for note in (target.name, target.note) if note),
                turns=case.planning.turns() if number is not None else None,
                carm=case.planning.carm() if number is not None else None,
            )


def _airways_of(case: OpenCase) -> Airways:
    airways = case.document.airways
    if airways is None:
        raise NoResultError(
            "the structures around the target are found from the airways: segment the airways first",
            code="plan.no-airways",
        )
    return airways


def with_target(document: Document, changed: Target) -> Document:
    """Return a document in which one target is replaced by a changed version of it."""
    targets = tuple(changed if one.target_id == changed.target_id else one for one in document.targets)
    return replace(document, targets=targets)
