"""The UDP bridge of the timing benchmark: ``python -m carina_haptics_bench.udp_bridge REQUEST``."""

from __future__ import annotations

import json
import socket
import sys
import time
from typing import Any

import numpy as np

from carina_haptics import decode_force, encode_sample

__all__ = ["measure_round_trips"]

BRIDGE_HZ = 500.0


def measure_round_trips(request: dict[str, Any]) -> dict[str, Any]:
    """Send samples at a steady rate and measure the time until each reply."""
    trips: list[float] = []
    num_sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", request["port"]))
        link.settimeout(0.05)
        x, y, z = request["center"]
        start = time.perf_counter()
        while (now := time.perf_counter()) - start < request["seconds"]:
            turn = 9.0 * (now - start)
            at = (x + 11.0 * np.cos(turn), y + 11.0 * np.sin(turn), z)
            num_sent += 1
            link.send(encode_sample(num_sent, int(now * 1e6), at, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
            try:
                reply = decode_force(link.recv(256))
            except TimeoutError:
                reply = None
            if reply is not None and reply.number == num_sent:
                trips.append(1e6 * (time.perf_counter() - now))
            time.sleep(max(0.0, start + num_sent / BRIDGE_HZ - time.perf_counter()))
    found = np.percentile(trips, [50, 99, 100]).tolist() if trips else [0.0, 0.0, 0.0]
    return {"round_trip_us": found, "num_sent": num_sent, "num_lost": num_sent - len(trips)}


if __name__ == "__main__":
    print(json.dumps(measure_round_trips(json.loads(sys.argv[1]))))
