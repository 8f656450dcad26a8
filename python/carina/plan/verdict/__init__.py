"""Verdict: whether an instrument reaches the target on a route, by a simulated drive."""
