"""Turns of a route: list, texts, pictures and clips."""
