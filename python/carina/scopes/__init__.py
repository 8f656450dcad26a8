"""The bronchoscope: where its tip is (pose) and how it sees (lens)."""

from carina.scopes.path_frames import PathFrames
from carina.scopes.pose import Pose, upright

__all__ = ["PathFrames", "Pose", "upright"]
