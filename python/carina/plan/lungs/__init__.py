"""Structures around a target: vessels, fissures and lobes."""
