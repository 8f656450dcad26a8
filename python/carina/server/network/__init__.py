"""Listening, access checks, connection limits, request timeouts and shutdown."""
