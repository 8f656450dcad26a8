"""Least-cost paths: in the lumen, to the point under the pointer, and through a whole volume (paper 6)."""
