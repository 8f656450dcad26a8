"""Conversion between lesions and their record in a case file."""

from __future__ import annotations

from typing import Any

import msgspec

from carina.case.bounds import check_plain
from carina.case.document import Lesion
from carina.case.error_texts import damage_error
from carina.commands.plan import PlanOptions
from carina.errors import CarinaError
from carina.plan import PlanTarget


class LesionFacts(msgspec.Struct, frozen=True, omit_defaults=True):
    """A lesion in a case file: the record of :meth:`carina.plan.PlanTarget.to_record`, and the planning options."""

    record: dict[str, Any]
    options: PlanOptions = PlanOptions()


def lesion_facts(lesion: Lesion) -> LesionFacts:
    """Return the record of a lesion for a case file."""
    return LesionFacts(lesion.target.to_record(), lesion.options)


def lesion_from_facts(facts: LesionFacts) -> Lesion:
    """Return a lesion from its record in a case file.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    where = "the boundary of a target"
    # The voxels of a nodule are one long string, so they are excluded from the limit on the length of texts.
    check_plain({name: value for name, value in facts.record.items() if name != "nodule"}, where)
    nodule = facts.record.get("nodule")
    check_plain(
        {name: value for name, value in nodule.items() if name != "inside"} if isinstance(nodule, dict) else {}, where
    )
    try:
        return Lesion(PlanTarget.from_record(facts.record), facts.options)
    except CarinaError as error:
        raise damage_error(where, "its record", str(error)[:200]) from None
