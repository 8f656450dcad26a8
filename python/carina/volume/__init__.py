"""CT volumes: reading them, and where their voxels are in the patient."""

from carina.volume.model import SeriesInfo, Volume, VolumeSource

__all__ = ["SeriesInfo", "Volume", "VolumeSource"]
