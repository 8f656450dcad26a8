"""Sending, receiving, limits and closing of a WebSocket."""
