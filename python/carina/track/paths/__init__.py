"""Least-cost paths: over the lumen, under the pointer, through a whole volume (paper 6)."""
