"""Three hosts on a network of their own: the link of one is cut in flight and restored. Root only."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from ray_rig import needs_ray

from carina.cluster.node import descendants, make_token, ray_environment, reap

SUBNET = "10.231.7"
PORT = 6399


def _may_make_networks() -> bool:
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or shutil.which("ip") is None:
        return False
    name = f"carina-probe-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False).returncode == 0
    if made:
        subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
    return made


pytestmark = [
    pytest.mark.ray,
    pytest.mark.slow,
    pytest.mark.soak,
    needs_ray,
    pytest.mark.filterwarnings("ignore"),
]

FLIGHT = """
import json, sys, time
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[4])
from carina.cluster import ClusterSettings
from carina.cluster.stand_in import StandInHost
from ray_rig import VIEW, ClusterRenderer, Console, Flight, Renderer, small_volume, wait_for
from carina.cluster.ray_backend import RayCluster

address, token, ip = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
console = Console(ClusterSettings(), keep_jobs=True)
cluster = RayCluster(console, address, token, ip=ip, host_class=StandInHost,
                     host_options={"row_seconds": 0.012 / 171}, poll_s=0.5)
renderer = ClusterRenderer(Renderer(small_volume()), console, spread_all=True)
renderer.prepare()
flight = Flight(console, renderer, cluster)
wait_for(lambda: len(flight.ready()) >= 3, 120)
print("ready", flush=True)

def fly(until):
    shown = []
    while not until(shown):
        began = time.monotonic()
        renderer.render(VIEW)
        shown.append(time.monotonic())
        time.sleep(max(0.0, 1 / 30 - (time.monotonic() - began)))
    return shown

for line in sys.stdin:
    what, seconds = line.split()
    if what == "fly":
        end = time.monotonic() + float(seconds)
        shown = fly(lambda _: time.monotonic() > end)
        print(json.dumps({"gap": float(max(np.diff(shown))), "ready": flight.ready()}), flush=True)
    elif what == "wait":
        wait_for(lambda: len(flight.ready()) >= int(seconds), 120)
        print(json.dumps({"ready": flight.ready()}), flush=True)
cluster.close()
console.close()
"""


class Hosts:
    """Namespaces joined by a bridge in one of their own."""

    def __init__(self) -> None:
        self.tag = f"cn{os.getpid() % 100000}"
        self.folder = Path(tempfile.mkdtemp(prefix="carina-ns-"))
        self.processes: list[subprocess.Popen] = []
        self._ip("netns", "add", f"{self.tag}b")
        self._inside("b", "ip", "link", "add", "br0", "type", "bridge")
        self._inside("b", "ip", "link", "set", "br0", "up")
        for n in range(3):
            self._ip("netns", "add", f"{self.tag}h{n}")
            self._ip("link", "add", f"{self.tag}v{n}", "type", "veth", "peer", "name", f"{self.tag}w{n}")
            self._ip("link", "set", f"{self.tag}v{n}", "netns", f"{self.tag}h{n}")
            self._ip("link", "set", f"{self.tag}w{n}", "netns", f"{self.tag}b")
            self._inside("b", "ip", "link", "set", f"{self.tag}w{n}", "master", "br0")
            self._inside("b", "ip", "link", "set", f"{self.tag}w{n}", "up")
            self._inside(f"h{n}", "ip", "addr", "add", f"{SUBNET}.{10 + n}/24", "dev", f"{self.tag}v{n}")
            for device in (f"{self.tag}v{n}", "lo"):
                self._inside(f"h{n}", "ip", "link", "set", device, "up")
            if shutil.which("tc"):
                shaped = ("rate", "1gbit", "burst", "256kb", "latency", "50ms")
                self._inside(f"h{n}", "tc", "qdisc", "add", "dev", f"{self.tag}v{n}", "root", "tbf", *shaped)

    def _ip(self, *arguments: str) -> None:
        subprocess.run(["ip", *arguments], check=True, capture_output=True)

    def _inside(self, host: str, *command: str) -> None:
        self._ip("netns", "exec", f"{self.tag}{host}", *command)

    def link(self, n: int, state: str) -> None:
        """Cut the cable of a host, or mend it."""
        self._inside("b", "ip", "link", "set", f"{self.tag}w{n}", state)

    def start(self, n: int, command: list[str], token: Path, **options) -> subprocess.Popen:
        """A program on a host, with temporary files and shared memory of its own."""
        private = 'mount -t tmpfs none /dev/shm && mount -t tmpfs none /tmp && exec "$@"'
        wrapped = ["ip", "netns", "exec", f"{self.tag}h{n}"]
        if options.pop("private", True):
            wrapped += ["unshare", "--mount", "sh", "-c", private, "sh"]
        environment = {**os.environ, **ray_environment(token, dedicated=True)}
        process = subprocess.Popen([*wrapped, *command], env=environment, start_new_session=True, text=True, **options)
        self.processes.append(process)
        return process

    def close(self) -> None:
        """End everything."""
        for process in reversed(self.processes):
            tree = descendants(process.pid)
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()
            reap(tree)
        for host in ("h0", "h1", "h2", "b"):
            subprocess.run(["ip", "netns", "del", f"{self.tag}{host}"], check=False, capture_output=True)
        shutil.rmtree(self.folder, ignore_errors=True)


@pytest.mark.skipif(not _may_make_networks(), reason="needs root and network namespaces")
def test_a_cut_link_costs_a_moment_and_the_host_serves_again_when_it_is_back():
    # Outside /tmp, which each host has for itself.
    home = Path(tempfile.mkdtemp(prefix="carina-ns-", dir="/var/tmp"))
    hosts = Hosts()
    try:
        token = make_token(home / "token")
        ray = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=0", "--disable-usage-stats"]
        ray += ["--object-store-memory=100000000", "--resources", json.dumps({"renderer": 1})]
        head = [*ray, "--head", f"--port={PORT}", "--include-dashboard=false", f"--node-ip-address={SUBNET}.10"]
        # The head shares /tmp with the console, which has to find its sockets.
        shared = home / "ray"
        hosts.start(0, [*head, f"--temp-dir={shared}"], token, private=False, stdout=subprocess.DEVNULL)

        def join(n: int) -> subprocess.Popen:
            # Supervised as docs/cluster.md says: a host that was declared dead joins again.
            again = 'while :; do "$@"; sleep 1; done'
            node = [*ray, f"--address={SUBNET}.10:{PORT}", f"--node-ip-address={SUBNET}.{10 + n}"]
            return hosts.start(n, ["sh", "-c", again, "sh", *node], token, stdout=subprocess.DEVNULL)

        time.sleep(12.0)
        join(1)
        join(2)
        console = [sys.executable, "-W", "ignore", "-c", FLIGHT, f"{SUBNET}.10:{PORT}", str(token), f"{SUBNET}.10"]
        console.append(str(Path(__file__).parent))
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        flight = hosts.start(0, console, token, private=False, **pipes)

        def ask(words: str) -> dict:
            flight.stdin.write(words + "\n")
            flight.stdin.flush()
            return json.loads(flight.stdout.readline())

        assert flight.stdout.readline().strip() == "ready"
        assert len(ask("fly 3")["ready"]) == 3
        gaps = []
        for n in (1, 2, 1):
            flight.stdin.write("fly 6\n")
            flight.stdin.flush()
            time.sleep(2.0)
            hosts.link(n, "down")
            gaps.append(json.loads(flight.stdout.readline())["gap"])
            hosts.link(n, "up")
            assert len(ask("wait 3")["ready"]) == 3
        print("gaps", gaps)
        assert sorted(gaps)[1] < 0.4
    finally:
        hosts.close()
        shutil.rmtree(home, ignore_errors=True)
