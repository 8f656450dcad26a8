"""The scope of a case: one setting for the airway view and for the plans of all targets."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from carina.case.document import Document, Target
from carina.scopes import DEFAULT_SCOPE, scope_preset


def document_with_scope(document: Document, name: str, *, resets_view: bool = False) -> Document:
    """Return a document whose airway view and plans use a scope; the same object if they use it already.

    With another scope, or with ``resets_view``, the view takes the scope's field of view and its outline, unless the
    user chose a full frame.

    Raises
    ------
    UsageError
        If the library has no such scope.
    """
    scope = scope_preset(name)
    look = document.look
    if look.scope != name or resets_view:
        outline = "none" if look.outline == "none" else scope.outline
        look = msgspec.structs.replace(look, scope=name, fov_deg=scope.usual_fov_deg, outline=outline)
    targets = _targets_with_scope(document, name)
    if look == document.look and all(a is b for a, b in zip(targets, document.targets, strict=True)):
        return document
    return replace(document, look=look, targets=targets)


def document_with_lesion(document: Document, target: Target) -> Document:
    """Return a document with a target with a size, which is new or replaces the target with the same ID.

    The plan of the target uses the scope of the case. A case begins with the generic scope, which is not an
    instrument; the first plan replaces it by the scope that plans use by default.
    """
    known = any(one.target_id == target.target_id for one in document.targets)
    targets = tuple(target if one.target_id == target.target_id else one for one in document.targets)
    changed = replace(document, targets=targets if known else (*targets, target))
    others = [one.lesion for one in document.targets if one.lesion is not None and one.target_id != target.target_id]
    chosen = document.look.scope
    if chosen is None:  # A pinhole camera is not an instrument, so the plans keep theirs.
        return (
            changed if not others else replace(changed, targets=_targets_with_scope(changed, others[0].options.scope))
        )
    if chosen == DEFAULT_SCOPE and not others and target.lesion is not None:
        chosen = target.lesion.options.scope
    return document_with_scope(changed, chosen)


def _targets_with_scope(document: Document, name: str) -> tuple[Target, ...]:
    return tuple(_target_with_scope(target, name) for target in document.targets)


def _target_with_scope(target: Target, name: str) -> Target:
    """Return a target whose plan uses a scope; the same object if it does already.

    A place that was chosen with another scope is not a place of this scope.
    """
    lesion = target.lesion
    if lesion is None or lesion.options.scope == name:
        return target
    options = msgspec.structs.replace(lesion.options, scope=name, place=None)
    return replace(target, lesion=replace(lesion, options=options))
