"""Moving the tip of the scope: freely or along a path, by hand, key or device."""

from carina.navigate.auto_flight import AutoFlight, KeyFrame, KeyFrameFlight
from carina.navigate.flight_path import FlightPath
from carina.navigate.moves import CONTROL_RANGES, Controls, Move
from carina.navigate.navigator import Navigator
from carina.navigate.one_euro import FilterSettings, SampleFilter
from carina.navigate.pilot import DeviceState, Pilot
from carina.navigate.recording import Recorder, Recording, case_key, open_recording
from carina.navigate.registration import Registration, fit_registration
from carina.navigate.samples import AxesSample, HandleSample, PoseSample, Sample, SampleGate

__all__ = [
    "CONTROL_RANGES",
    "AutoFlight",
    "AxesSample",
    "Controls",
    "DeviceState",
    "FilterSettings",
    "FlightPath",
    "HandleSample",
    "KeyFrame",
    "KeyFrameFlight",
    "Move",
    "Navigator",
    "Pilot",
    "PoseSample",
    "Recorder",
    "Recording",
    "Registration",
    "Sample",
    "SampleFilter",
    "SampleGate",
    "case_key",
    "fit_registration",
    "open_recording",
]
