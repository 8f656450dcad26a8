"""Flight on three machines in separate network namespaces, started by test_network.py as root in the head's namespace.

The arguments are a folder and the prefix of the namespaces; the output is one JSON object. Each machine has its own
shared memory and Ray folder, because several Rays that start in one folder disturb each other.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from ray_cluster import VIEW, Head, flying, wait_for

from carina.cluster import ClusterSettings
from carina.cluster.node import Node, make_token
from carina_bench.cluster_sleeping_renderer import SleepingRenderer
from user_folders import environment_in

ADDRESSES = [f"10.231.77.{10 + n}" for n in range(3)]
PORT = 6399
OWN_FOLDERS = (
    'mount -t tmpfs tmpfs /dev/shm && mkdir -p "$RAY_FOLDER" && mount -t tmpfs tmpfs "$RAY_FOLDER" && exec "$@"'
)


def user_folders(folder: Path) -> list[str]:
    """Return the beginning of a command line that gives a machine a separate shared memory and Ray folder."""
    return ["unshare", "-m", "env", f"RAY_FOLDER={folder / 'ray'}", "sh", "-c", OWN_FOLDERS, "machine"]


def link(prefix: str, host: int, state: str) -> None:
    """Set the port of a machine on the network switch to ``up`` or ``down``."""
    subprocess.run(["ip", "-n", f"{prefix}s", "link", "set", f"p{host}", state], check=True, timeout=20)


def join(folder: Path, prefix: str, host: int) -> subprocess.Popen[bytes]:
    """Start ``carina cluster join`` on a machine."""
    home = folder / f"home{host}"
    home.mkdir()
    text = (folder / f"join{host}.log").open("wb")
    command = ["ip", "netns", "exec", f"{prefix}{host}", *user_folders(folder), sys.executable, "-m", "carina.cli"]
    command += ["cluster", "join", f"{ADDRESSES[0]}:{PORT}", "--ip", ADDRESSES[host], "--dedicated"]
    command += ["--token-file", str(folder / "token")]
    environment = {**environment_in(home), "HOME": str(home)}
    return subprocess.Popen(command, env=environment, stdout=text, stderr=subprocess.STDOUT)


def fly(flight, seconds: float, until=lambda: False) -> list[float]:
    """Request at most 25 pictures a second and check each one; return the times at which they were shown, s."""
    began_s = time.monotonic()
    shown = [began_s]
    while time.monotonic() < began_s + seconds and not until():
        picture = flight.renderer.render(VIEW)
        shown.append(time.monotonic())
        flight.check(picture)
        time.sleep(max(0.0, 0.04 - (time.monotonic() - shown[-1])))
    return shown


def longest_ms(shown: list[float]) -> float:
    """Return the longest time between two pictures in ms."""
    return 1e3 * max(b - a for a, b in itertools.pairwise(shown))


def renders(flight, name: str) -> bool:
    """Return whether new pictures contain strips of the machine ``name``."""
    before = len(flight.console.jobs)
    fly(flight, 0.5)
    return name in {job.lane for job in flight.console.jobs[before:] if job.accepted}


def main(folder: Path, prefix: str) -> dict[str, object]:
    """Run the flight with all interruptions of links, and return its figures."""
    token = make_token(folder / "token")
    node = Node(
        token, head=True, ip=ADDRESSES[0], port=PORT, dedicated=True, temp_dir=folder / "ray", log=folder / "head.log",
        store_bytes=100 * 2**20,
    )  # fmt: skip
    joined = []
    try:
        node.wait_ready(120.0)
        head = Head(node, token, folder)
        with flying(
            head, SleepingRenderer, num=1, settings=ClusterSettings(), ip=ADDRESSES[0], row_seconds=0.02 / 170
        ) as flight:
            # The other two machines join during the flight.
            joined = [join(folder, prefix, host) for host in (1, 2)]
            fly(flight, 150.0, until=lambda: len(flight.ready()) == 3)
            wait_for(lambda: len(flight.ready()) == 3, 30.0)
            fly(flight, 3.0)
            quiet_ms = longest_ms(fly(flight, 2.0))
            gaps_ms = []
            for n in range(5):
                host = 1 + n % 2
                link(prefix, host, "down")
                gaps_ms.append(longest_ms(fly(flight, 1.0)))
                link(prefix, host, "up")
                fly(flight, 60.0, until=lambda: len(flight.ready()) == 3)
                fly(flight, 1.0)
            # The interruption is so long that Ray removes the machine, which must join again without help.
            link(prefix, 2, "down")
            gone = f"the machine {ADDRESSES[2]} has left the cluster"
            fly(flight, 60.0, until=lambda: gone in flight.console.status().notices)
            left = gone in flight.console.status().notices
            link(prefix, 2, "up")
            cut_s = time.monotonic()
            fly(flight, 150.0, until=lambda: ADDRESSES[2] in flight.ready())
            back_s = time.monotonic() - cut_s
            serves = renders(flight, ADDRESSES[2])
            return {
                "quiet_ms": round(quiet_ms),
                "gaps_ms": [round(gap) for gap in gaps_ms],
                "median_ms": round(statistics.median(gaps_ms)),
                "left": left,
                "serves_again": serves,
                "back_s": round(back_s, 1),
                "load": round(os.getloadavg()[0], 1),
                "notices": list(flight.console.status().notices),
            }
    finally:
        for process in joined:
            process.terminate()
        for process in joined:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(40.0)
        node.stop()


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), sys.argv[2])))
