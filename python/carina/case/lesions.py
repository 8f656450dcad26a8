"""Targets with a size, as a case file stores them."""

from __future__ import annotations

from typing import Any

import msgspec

from carina.case.bounds import check_plain
from carina.case.document import Lesion
from carina.case.trouble import damaged
from carina.commands.plan import PlanOptions
from carina.errors import CarinaError
from carina.plan import PlanTarget

__all__ = ["LesionFacts", "lesion_facts", "made_lesion"]


class LesionFacts(msgspec.Struct, frozen=True, omit_defaults=True):
    """The target as :meth:`carina.plan.PlanTarget.to_record`, and how the way to it is planned."""

    record: dict[str, Any]
    options: PlanOptions = PlanOptions()


def lesion_facts(lesion: Lesion) -> LesionFacts:
    """Return the facts of a target's boundary, as a case file stores them."""
    return LesionFacts(lesion.target.to_record(), lesion.options)


def made_lesion(facts: LesionFacts) -> Lesion:
    """Return the boundary of a target from the facts in a case file.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    where = "the boundary of a target"
    # The voxels of a nodule are one long text, so the limit on texts does not apply.
    check_plain({name: value for name, value in facts.record.items() if name != "nodule"}, where)
    nodule = facts.record.get("nodule")
    check_plain(
        {name: value for name, value in nodule.items() if name != "inside"} if isinstance(nodule, dict) else {}, where
    )
    try:
        return Lesion(PlanTarget.from_record(facts.record), facts.options)
    except CarinaError as trouble:
        raise damaged(where, "its record", str(trouble)[:200]) from None
