"""The workstation's server: one process, one window, loopback."""

from carina.server.serve import serve

__all__ = ["serve"]
