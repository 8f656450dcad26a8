"""Observers: windows that show the case and change nothing, and their page in the local network."""
