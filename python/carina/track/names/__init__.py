"""Anatomical names of the branches of a tree."""
