"""Benchmark of force feedback: ``python -m carina_haptics_bench`` (see the guide of the package)."""
