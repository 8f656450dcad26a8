"""The bronchoscope: where its tip is (pose) and how it sees (lens)."""

from carina.scopes.pose import Pose, upright

__all__ = ["Pose", "upright"]
