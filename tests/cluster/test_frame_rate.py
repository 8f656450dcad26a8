"""Rate of complete pictures of a cluster."""

from __future__ import annotations

from carina.cluster.frame_rate import RateMeter


def test_rate_without_requests_discards_old_pictures():
    meter = RateMeter()
    for n in range(10_000):
        meter.note(n * 0.01, 0.005)
    assert len(meter._times) <= 102
    assert meter.rate_hz(99.99) in {100.0, 101.0}  # pictures at both ends of the second may count
    assert meter.median_s == 0.005
