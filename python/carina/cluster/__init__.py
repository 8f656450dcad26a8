"""Rendering of one picture on several machines (paper 5): scheduler, lanes (connections to renderers) and renderer."""

from carina.cluster.console import Console
from carina.cluster.lanes import Lane, LaneFacts, LocalLane, StripAnswer, StripOrder
from carina.cluster.renderer import ClusterRenderer, render_frames
from carina.cluster.settings import ClusterSettings
from carina.render import ClusterStatus, MemberStatus

__all__ = [
    "ClusterRenderer",
    "ClusterSettings",
    "ClusterStatus",
    "Console",
    "Lane",
    "LaneFacts",
    "LocalLane",
    "MemberStatus",
    "StripAnswer",
    "StripOrder",
    "render_frames",
]
