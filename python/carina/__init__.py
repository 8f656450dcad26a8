"""Carina: an open virtual bronchoscopy workstation."""

__version__ = "0.1.0"
