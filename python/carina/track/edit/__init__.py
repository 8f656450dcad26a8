"""Mending an airway tree by hand, and what in the CT speaks for it."""
