"""Navigation: movement of the scope's tip, freely or along a path, by hand, key or device."""

from carina.navigate.auto_flight import AutoFlight
from carina.navigate.flight_path import FlightPath
from carina.navigate.key_files import KeyFrameFile, Through, open_key_frames
from carina.navigate.key_frames import MAX_SPEED_MM_S, MIN_SPEED_MM_S, KeyFrame, KeyFrameFlight
from carina.navigate.key_legs import AirwayWay
from carina.navigate.moves import Move
from carina.navigate.navigator import Navigator
from carina.navigate.one_euro import SampleFilter, filter_latency_ms
from carina.navigate.pilot import DeviceState, PenState, Pilot
from carina.navigate.recording import Recorder, Recording, case_key, open_recording
from carina.navigate.registration import Registration, fit_registration
from carina.navigate.samples import AxesSample, HandleSample, PoseSample, Sample, SampleGate

__all__ = [
    "MAX_SPEED_MM_S",
    "MIN_SPEED_MM_S",
    "AirwayWay",
    "AutoFlight",
    "AxesSample",
    "DeviceState",
    "FlightPath",
    "HandleSample",
    "KeyFrame",
    "KeyFrameFile",
    "KeyFrameFlight",
    "Move",
    "Navigator",
    "PenState",
    "Pilot",
    "PoseSample",
    "Recorder",
    "Recording",
    "Registration",
    "Sample",
    "SampleFilter",
    "SampleGate",
    "Through",
    "case_key",
    "filter_latency_ms",
    "fit_registration",
    "open_key_frames",
    "open_recording",
]
