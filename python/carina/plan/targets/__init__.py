"""Targets of a plan: nodules, their boundaries, and targets from clicks, masks and files."""
