"""A target's nodule as a case file holds it: its figures as JSON, its voxels as deflated bits in that."""

from __future__ import annotations

import base64
import binascii
from typing import Annotated, get_args

import msgspec
import numpy as np
from msgspec import Meta

from carina.case.document import Lesion
from carina.case.packing import deflated, inflated
from carina.case.trouble import damaged
from carina.commands.fields import Matrix4, PointLps, Words
from carina.commands.plan import PlanOptions
from carina.plan.nodule import Nodule, NoduleKind

__all__ = ["LesionFacts", "lesion_facts", "made_lesion"]

MAX_BOX_VOXELS = 64_000_000
WHERE = "the nodule of a target"
Mm3 = Annotated[float, Meta(ge=0.0, le=1e9)]
Length = Annotated[float, Meta(ge=0.0, le=1e4)]
Size = Annotated[int, Meta(ge=1, le=4096)]


class LesionFacts(msgspec.Struct, frozen=True, omit_defaults=True):
    """As :class:`carina.plan.Nodule`; ``inside`` are the bits of its voxels, z slowest, deflated, base 64."""

    centre_lps: PointLps
    kind: Words
    volume_mm3: Mm3
    volume_error_mm3: Mm3
    long_mm: Length
    short_mm: Length
    diameter_error_mm: Length
    solid_mm3: Mm3
    density_hu: Annotated[float, Meta(ge=-1e5, le=1e5)]
    touches: Annotated[tuple[Words, ...], Meta(max_length=20)]
    shape_zyx: tuple[Size, Size, Size]
    lps_from_ijk: Matrix4
    inside: Annotated[str, Meta(max_length=16 << 20)]
    options: PlanOptions = PlanOptions()


def lesion_facts(lesion: Lesion) -> LesionFacts:
    """What is written."""
    nodule = lesion.nodule
    nz, ny, nx = nodule.inside_zyx.shape
    bits = np.packbits(nodule.inside_zyx.astype(bool).ravel()).tobytes()
    x, y, z = (float(v) for v in nodule.centre_lps)
    return LesionFacts(
        centre_lps=(x, y, z),
        kind=nodule.kind,
        volume_mm3=float(nodule.volume_mm3),
        volume_error_mm3=float(nodule.volume_error_mm3),
        long_mm=float(nodule.long_mm),
        short_mm=float(nodule.short_mm),
        diameter_error_mm=float(nodule.diameter_error_mm),
        solid_mm3=float(nodule.solid_mm3),
        density_hu=float(nodule.density_hu),
        touches=tuple(nodule.touches),
        shape_zyx=(nz, ny, nx),
        lps_from_ijk=tuple(float(v) for v in np.asarray(nodule.lps_from_ijk, dtype=np.float64).ravel()),
        inside=base64.b64encode(deflated(bits)).decode(),
        options=lesion.options,
    )


def made_lesion(facts: LesionFacts) -> Lesion:
    """What was written.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    kinds = get_args(NoduleKind)
    if facts.kind not in kinds:
        raise damaged(WHERE, f"a kind of {', '.join(kinds)}", facts.kind)
    num_voxels = int(np.prod(facts.shape_zyx))
    if num_voxels > MAX_BOX_VOXELS:
        raise damaged(WHERE, f"at most {MAX_BOX_VOXELS} voxels", f"{num_voxels}")
    try:
        packed = base64.b64decode(facts.inside, validate=True)
    except (binascii.Error, ValueError):
        raise damaged(WHERE, "bits in base 64", "other text") from None
    bits = np.frombuffer(inflated(packed, -(-num_voxels // 8), WHERE), dtype=np.uint8)
    inside = np.unpackbits(bits, count=num_voxels).astype(bool).reshape(facts.shape_zyx)
    nodule = Nodule(
        centre_lps=facts.centre_lps,
        kind=_kind(facts.kind),
        volume_mm3=facts.volume_mm3,
        volume_error_mm3=facts.volume_error_mm3,
        long_mm=facts.long_mm,
        short_mm=facts.short_mm,
        diameter_error_mm=facts.diameter_error_mm,
        solid_mm3=facts.solid_mm3,
        density_hu=facts.density_hu,
        touches=facts.touches,
        inside_zyx=inside,
        lps_from_ijk=np.array(facts.lps_from_ijk, dtype=np.float64).reshape(4, 4),
    )
    return Lesion(nodule, facts.options)


def _kind(word: str) -> NoduleKind:
    found: dict[str, NoduleKind] = {kind: kind for kind in get_args(NoduleKind)}
    return found[word]
