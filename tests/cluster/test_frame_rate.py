"""Test of the measured rate of complete pictures of a cluster."""

from __future__ import annotations

from carina.cluster.frame_rate import RateMeter


def test_frame_rate_counts_only_pictures_of_the_last_second():
    meter = RateMeter()
    for n in range(10_000):
        meter.note(n * 0.01, 0.005)
    assert len(meter._times) <= 102
    assert meter.rate_hz(99.99) in {100.0, 101.0}  # The pictures at both ends of the second may count or not.
    assert meter.median_s == 0.005
