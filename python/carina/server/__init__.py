"""Server of the workstation, which serves the web client to browsers."""

from carina.server.serve import serve

__all__ = ["serve"]
