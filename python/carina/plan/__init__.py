"""Planning: from a nodule in the lung to a way there."""

from carina.plan.nodule import Nodule, NoduleKind, grow_nodule

__all__ = ["Nodule", "NoduleKind", "grow_nodule"]
