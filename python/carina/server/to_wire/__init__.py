"""Conversion of the session's values to messages."""
