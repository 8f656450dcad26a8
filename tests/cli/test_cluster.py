"""``carina cluster`` and ``carina open --cluster`` as a person types them."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from carina.cluster.node import descendants

needs_ray = pytest.mark.skipif(
    not sys.platform.startswith("linux") or importlib.util.find_spec("ray") is None,
    reason="needs Linux and Ray: pip install 'carina[cluster]'",
)
COMMAND = [sys.executable, "-m", "carina.cli"]


def _environment(tmp_path) -> dict[str, str]:
    homes = {name: str(tmp_path / name) for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME")}
    return {**os.environ, **homes, "HOME": str(tmp_path)}


def _run(tmp_path, *arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments],
        env=_environment(tmp_path),
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def _began(pid: int) -> str | None:
    """When a process began, or None where there is none."""
    from carina.cluster.node import _parents

    found = _parents().get(pid)
    return None if found is None else found[1]


@needs_ray
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["cluster", "start"], 2, "start --head"),
        (["cluster", "join", "nowhere:door"], 1, "no token"),
        (["cluster", "status", "127.0.0.2:1"], 1, "no token"),
        (["open", "--mixed"], 2, "--cluster"),
        (["open", "--cluster", "127.0.0.2:1"], 1, "no token"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_started(tmp_path, arguments, code, words):
    done = _run(tmp_path, *arguments, "--json")
    assert done.returncode == code, done.stderr
    assert words in json.loads(done.stdout)["error"]["message"]


@needs_ray
@pytest.mark.ray
@pytest.mark.slow
def test_a_cluster_is_started_looked_at_used_and_left_without_a_trace(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.2", 0))
        port = probe.getsockname()[1]
    start = [*COMMAND, "cluster", "start", "--head", "--ip", "127.0.0.2", "--port", str(port), "--json"]
    head = subprocess.Popen(start, env=_environment(tmp_path), stdout=subprocess.PIPE, text=True)
    tree = {}
    try:
        lines = []
        while not lines or lines[-1].rstrip() != "}":
            line = head.stdout.readline()
            assert line, "the head has ended"
            lines.append(line)
        told = json.loads("".join(lines))
        assert told["address"] == f"127.0.0.2:{port}"
        status = _run(tmp_path, "cluster", "status", told["address"], "--json")
        assert status.returncode == 0, status.stderr
        [member] = json.loads(status.stdout)["members"]
        assert member["ip"] == "127.0.0.2" and member["renderers"] == 1 and not member["busy"]
        used = subprocess.Popen(
            [*COMMAND, "open", "--cluster", told["address"], "--no-browser", "--json"],
            env=_environment(tmp_path),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert used.stdout.readline().startswith("{")
        finally:
            used.send_signal(signal.SIGINT)
            _, words = used.communicate(timeout=60)
        assert used.returncode == 0, words
        tree = descendants(head.pid)
        assert tree
    finally:
        head.send_signal(signal.SIGTERM)
        head.communicate(timeout=60)
    assert not [pid for pid, began in tree.items() if _began(pid) == began], "processes were left behind"
