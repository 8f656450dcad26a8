"""Test of interrupted network links between three machines in network namespaces (make soak; needs root)."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from network_flight import ADDRESSES, user_folders
from ray_cluster import import_path, needs_ray


def _ip(*arguments: str) -> bool:
    return subprocess.run(["ip", *arguments], capture_output=True, timeout=20, check=False).returncode == 0


@contextlib.contextmanager
def _network(prefix: str) -> Iterator[None]:
    """Create namespaces ``<prefix>0`` to ``2``, and a switch in a fourth one, apart from the machine's network."""
    names = [f"{prefix}{n}" for n in range(3)]
    switch = f"{prefix}s"
    try:
        for name in (switch, *names):
            assert _ip("netns", "add", name)
            assert _ip("-n", name, "link", "set", "lo", "up")
        assert _ip("-n", switch, "link", "add", "switch", "type", "bridge")
        assert _ip("-n", switch, "link", "set", "switch", "up")
        for n, name in enumerate(names):
            assert _ip("link", "add", f"p{n}", "netns", switch, "type", "veth", "peer", "name", "eth0", "netns", name)
            assert _ip("-n", switch, "link", "set", f"p{n}", "master", "switch", "up")
            assert _ip("-n", name, "address", "add", f"{ADDRESSES[n]}/24", "dev", "eth0")
            assert _ip("-n", name, "link", "set", "eth0", "up")
        yield
    finally:
        for name in (switch, *names):
            _ip("netns", "delete", name)


def _can_have_networks() -> bool:
    if sys.platform != "linux" or os.geteuid() != 0 or any(shutil.which(t) is None for t in ("ip", "unshare", "mount")):
        return False
    name = f"carina{os.getpid()}t"
    can = _ip("netns", "add", name)
    return _ip("netns", "delete", name) and can


@pytest.mark.soak
@pytest.mark.ray
@needs_ray
@pytest.mark.skipif(not _can_have_networks(), reason="needs root, and leave to make network namespaces")
def test_interrupted_network_link_delays_pictures_briefly_and_the_machine_rejoins():
    # Ray puts sockets into this folder, and their paths must be short.
    folder = Path(tempfile.mkdtemp(prefix="carina-net-"))
    prefix = f"carina{os.getpid()}n"
    flight = Path(__file__).with_name("network_flight.py")
    try:
        with _network(prefix):
            command = ["ip", "netns", "exec", f"{prefix}0", *user_folders(folder), sys.executable, "-W", "ignore"]
            command += [str(flight), str(folder), prefix]
            environment = {**os.environ, **import_path()}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900, check=False)
        words = "\n".join(f"{log.name}: {log.read_text()[-1500:]}" for log in folder.glob("*.log"))
        assert done.returncode == 0, f"{done.stderr[-3000:]}\n{words}"
        found = json.loads(done.stdout.splitlines()[-1])
        print(found)
        assert found["median_ms"] < 400
        assert found["left"], "Ray removed the machine, which must join again"
        assert found["serves_again"]
        assert sum("has left" in notice for notice in found["notices"]) == 1
    finally:
        shutil.rmtree(folder, ignore_errors=True)
