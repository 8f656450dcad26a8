"""Paths to targets, also with the costs and graphs of the paper (paper 6)."""
