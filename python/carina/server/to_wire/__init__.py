"""Conversion of the session's values to messages of the wire protocol."""
