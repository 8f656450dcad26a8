"""The bridge of ``carina bench haptics``: ``python -m carina_bench.haptics_bridge REQUEST``."""

from __future__ import annotations

import json
import sys

from carina_bench.haptics import bridge

if __name__ == "__main__":
    print(json.dumps(bridge(json.loads(sys.argv[1]))))
