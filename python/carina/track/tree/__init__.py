"""Airway tree as a value: branches, drawn and uncertain parts, and the path between two points."""
