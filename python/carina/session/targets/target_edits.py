"""Commands that edit targets with a size: boundary, aims, spheres and import from files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from carina import commands as c
from carina.case.document import Lesion, Target
from carina.case.scope_choice import document_with_lesion
from carina.errors import CarinaError, UsageError, without_options
from carina.plan import (
    Nodule,
    PlanTarget,
    brushed,
    proposed_aims,
    resized,
    sphere,
    target_doubts,
    whereabouts,
)
from carina.plan.targets.doubts import confirmed_codes
from carina.session.command_registry import CommandHandlers, does
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase
from carina.session.state.snapshot import UserMessage
from carina.session.targets.ct_location import ct_of
from carina.session.targets.retrack import needed_target


class TargetHandlers(CommandHandlers):
    """Commands that edit targets with a size; each forms one undo step, and the plan is then computed again."""

    @does(c.ResizeTarget)
    def resize(self, command: c.ResizeTarget) -> str:
        """Resize a target to a diameter by moving its boundary by the same distance everywhere."""
        return self._edit(
            command.target_id,
            "resize",
            lambda nodule, case: resized(nodule, case.info.volume, command.diameter_mm),
        )

    @does(c.BrushTarget)
    def brush(self, command: c.BrushTarget) -> str:
        """Add or remove a ball at each point of a stroke."""
        return self._edit(
            command.target_id,
            "erase from" if command.takes_away else "paint",
            lambda nodule, case: brushed(
                nodule, case.info.volume, command.stroke_lps, command.brush_mm, add=not command.takes_away
            ),
        )

    @does(c.AimTarget)
    def aim(self, command: c.AimTarget) -> None:
        """Set the aim points of a target: its middle, or proposed points that include its periphery."""
        case = self.core.needed_case()
        with self.core.lock:
            target, lesion = self._lesion(case, command.target_id)
            aims = proposed_aims(lesion.nodule) if command.periphery else ()
            changed = replace(lesion.target, aims=aims)
            self._put(case, replace(target, lesion=replace(lesion, target=changed)), f"aims in {target.name}")

    @does(c.ConfirmTarget)
    def confirm(self, command: c.ConfirmTarget) -> None:
        """Confirm doubts whether a target is a nodule; the routes to the target are then planned."""
        case = self.core.needed_case()
        with self.core.lock:
            target, lesion = self._lesion(case, command.target_id)
            codes = tuple(dict.fromkeys((*lesion.target.confirmed, *confirmed_codes(command.doubts))))
            if codes != lesion.target.confirmed:
                changed = replace(lesion.target, confirmed=codes)
                self._put(case, replace(target, lesion=replace(lesion, target=changed)), f"confirm {target.name}")

    @does(c.MarkSphere)
    def mark_sphere(self, command: c.MarkSphere) -> None:
        """Add a sphere as a target, without segmentation of the CT."""
        case = self.core.needed_case()
        case.check_inside(command.lps)
        nodule = sphere(case.info.volume, command.lps, command.diameter_mm)
        doubts = target_doubts(case.info.volume, nodule, airways=case.document.airways)
        with self.core.lock:
            number = case.next_number("target")
            target_id, name = f"target-{number}", f"Target {number}"
            where = whereabouts(case.info.volume, nodule)
            target = PlanTarget(target_id, name, nodule, command.lps, "sphere", where, doubts=doubts)
            self._add(case, Target(target_id, name, command.lps, lesion=Lesion(target)))

    @does(c.TakeTarget)
    def take_target(self, command: c.TakeTarget) -> str:
        """Read a target from a file in the background; refuse a file that is not a target of this scan."""
        case = self.core.needed_case()
        with self.core.lock:
            number = case.next_number("target")
        structure = command.structure
        named = int(structure) if structure is not None and structure.isdecimal() else structure

        def work(job: Job) -> None:
            from carina.plan import target_from_file  # slow to import

            try:
                target = target_from_file(
                    command.path,
                    case.info.volume,
                    structure=named,
                    ct=ct_of(case),
                    target_id=f"target-{number}",
                    compare_click=True,
                    progress=job.progress,
                    cancel=job.cancel,
                )
            except CarinaError as error:
                error.args = (without_options(str(error)), *error.args[1:])
                raise
            with self.core.lock:
                job.check()
                self._add(case, Target(target.target_id, target.name, target.nodule.middle_lps, lesion=Lesion(target)))
                for note in target.nodule.notes:
                    self.core.emit(UserMessage(f"{target.name}: {note}"))

        return self.core.jobs.start("target file", "reading the target", work)

    def _edit(self, target_id: str, what: str, change: Callable[[Nodule, OpenCase], Nodule]) -> str:
        case = self.core.needed_case()
        with self.core.lock:
            title = f"{what} {self._lesion(case, target_id)[0].name}"

        def work(job: Job) -> None:
            while True:
                with self.core.lock:
                    job.check()
                    lesion = self._lesion(case, target_id)[1]
                changed = change(lesion.nodule, case)
                doubts = target_doubts(case.info.volume, changed, airways=case.document.airways)
                with self.core.lock:
                    job.check()
                    target, now = self._lesion(case, target_id)
                    # If another edit has changed the target meanwhile, this edit is repeated on the present target.
                    if now.nodule is lesion.nodule:
                        reported = now.target.with_nodule(changed, doubts)
                        self._put(case, replace(target, lesion=replace(now, target=reported)), title)
                        return

        return self.core.jobs.start(f"edit {target_id} {id(work)}", title, work)

    def _lesion(self, case: OpenCase, target_id: str) -> tuple[Target, Lesion]:
        target = needed_target(case.document, target_id)
        if target.lesion is None:
            raise UsageError(f"{target.name} is a place in the airways: it has no boundary", code="plan.target")
        return target, target.lesion

    def _put(self, case: OpenCase, changed: Target, label: str) -> None:
        document = case.document
        targets = tuple(changed if one.target_id == changed.target_id else one for one in document.targets)
        self.core.change(case, label, replace(document, targets=targets))

    def _add(self, case: OpenCase, target: Target) -> None:
        self.core.change(case, f"add {target.name}", document_with_lesion(case.document, target))
        if target.lesion is not None:
            self.core.emit(UserMessage(f"{target.name}: {target.lesion.nodule.words}"))
