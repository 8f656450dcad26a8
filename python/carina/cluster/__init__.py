"""Many machines render one picture (paper 5): the scheduler, its lanes, and a renderer that uses them."""

from carina.cluster.settings import ClusterSettings

__all__ = ["ClusterSettings"]
