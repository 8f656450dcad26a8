"""An airway tree as a value: branches, what of it is drawn or uncertain, the way between two places."""
