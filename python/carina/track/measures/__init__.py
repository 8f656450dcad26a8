"""Measurements of airways: sections, branches and forks."""
