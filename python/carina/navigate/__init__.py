"""Moving the tip of the scope: freely or along a path, by hand, key or device."""

from carina.navigate.flight_path import FlightPath
from carina.navigate.moves import Controls, Move
from carina.navigate.navigator import Navigator
from carina.navigate.one_euro import FilterSettings, SampleFilter
from carina.navigate.pilot import DeviceState, Pilot
from carina.navigate.registration import Registration, fit_registration
from carina.navigate.samples import AxesSample, HandleSample, PoseSample, Sample, SampleGate

__all__ = [
    "AxesSample",
    "Controls",
    "DeviceState",
    "FilterSettings",
    "FlightPath",
    "HandleSample",
    "Move",
    "Navigator",
    "Pilot",
    "PoseSample",
    "Registration",
    "Sample",
    "SampleFilter",
    "SampleGate",
    "fit_registration",
]
