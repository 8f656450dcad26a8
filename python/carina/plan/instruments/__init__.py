"""Instruments: tools in the working channel, and the user's own instrument files."""
