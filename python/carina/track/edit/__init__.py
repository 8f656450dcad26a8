"""Manual edits of an airway tree, and the evidence for them in the CT."""
