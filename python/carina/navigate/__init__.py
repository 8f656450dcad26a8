"""Moving the tip of the scope: freely, or along a path."""

from carina.navigate.flight_path import FlightPath
from carina.navigate.navigator import Navigator

__all__ = ["FlightPath", "Navigator"]
