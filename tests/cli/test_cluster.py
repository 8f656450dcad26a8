"""Tests of the commands ``carina cluster`` and ``carina open --cluster``."""

from __future__ import annotations

import importlib.util
import json
import signal
import socket
import subprocess
import sys
import types

import pytest

from carina.cli import cluster
from carina.cluster.node import descendants
from carina.errors import ClusterError
from user_folders import environment_in

needs_ray = pytest.mark.skipif(
    not sys.platform.startswith("linux") or importlib.util.find_spec("ray") is None,
    reason="needs Linux and Ray (make setup-tests)",
)
COMMAND = [sys.executable, "-m", "carina.cli"]


def _environment(tmp_path) -> dict[str, str]:
    return {**environment_in(tmp_path), "HOME": str(tmp_path)}


def _run(tmp_path, *arguments: str, timeout: float = 600.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *arguments],
        env=_environment(tmp_path),
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def _began(pid: int) -> str | None:
    """Return the start time of a process, or None if it does not exist."""
    from carina.cluster.node import _parents

    found = _parents().get(pid)
    return None if found is None else found[1]


@needs_ray
@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["cluster", "start"], 2, "start --head"),
        (["cluster", "join", "nowhere:door"], 1, "no token"),
        (["cluster", "status", "127.0.0.2:1"], 1, "no token"),
        (["open", "--mixed"], 2, "--cluster"),
        (["open", "--token-file", "cluster.token"], 2, "--cluster"),
        (["open", "--cluster", "127.0.0.2:1"], 1, "no token"),
    ],
)
def test_invalid_cluster_arguments_are_refused_before_any_process_starts(carina, arguments, code, text):
    done = carina(*arguments, "--json")
    assert done.code == code, done.err
    assert text in done.json()["error"]["message"]


class StubNode:
    """Replacement of a cluster node; each new instance follows the next line of a script."""

    address, ip = "10.0.0.1:6379", "10.0.0.2"

    def __init__(self, script: list[str], made: list[StubNode]) -> None:
        self._line = script[len(made)]
        self.num_stopped = 0
        made.append(self)

    def wait_ready(self) -> None:
        if self._line == "no answer":
            raise ClusterError("no answer from 10.0.0.1:6379", code="cluster.start")

    @property
    def running(self) -> bool:
        if self._line == "until Ctrl-C":
            raise KeyboardInterrupt
        return False

    def stop(self) -> None:
        self.num_stopped += 1


def _join(monkeypatch, tmp_path, *script: str) -> tuple[list[StubNode], list[float]]:
    """Run ``carina cluster join`` with these nodes; return the nodes and the pauses between attempts, s."""
    made: list[StubNode] = []
    pauses_s: list[float] = []
    monkeypatch.setattr(cluster, "check_available", lambda: None)
    monkeypatch.setattr(cluster, "check_token", lambda path: path)
    monkeypatch.setattr(cluster, "_log_file", lambda: tmp_path / "log")
    monkeypatch.setattr(cluster, "Node", lambda *_, **__: StubNode(list(script), made))
    monkeypatch.setattr(cluster, "time", types.SimpleNamespace(sleep=pauses_s.append, monotonic=lambda: 0.0))
    try:
        cluster.join("10.0.0.1:6379", ip=None, dedicated=False, token=tmp_path / "token", as_json=False)
    finally:
        assert [node.num_stopped for node in made] == [1] * len(made)
    return made, pauses_s


def test_machine_that_was_a_cluster_member_rejoins_after_any_interruption(monkeypatch, tmp_path, capsys):
    made, pauses_s = _join(monkeypatch, tmp_path, "dropped", *["no answer"] * 5, "dropped", "until Ctrl-C")
    assert len(made) == 8
    assert pauses_s == [1.0, 2.0, 5.0, 10.0, 10.0, 10.0, 10.0]
    result = capsys.readouterr()
    assert result.out.count("has joined the cluster") == 1
    assert result.err.count("no answer from 10.0.0.1:6379; trying again in") == 5
    assert result.err.count("has rejoined the cluster at 10.0.0.1:6379") == 2
    assert result.err.endswith("left the cluster\n")


def test_join_command_exits_with_the_reason_if_the_machine_cannot_join_the_cluster(monkeypatch, tmp_path):
    with pytest.raises(ClusterError, match="no answer"):
        _join(monkeypatch, tmp_path, "no answer")


def test_local_cluster_warns_about_its_open_ports_before_it_opens_them(monkeypatch, tmp_path, capsys):
    warning = ""

    def node(*_: object, **__: object) -> None:
        nonlocal warning
        warning = capsys.readouterr().err
        raise ClusterError("enough", code="cluster.start")

    backend = types.ModuleType("carina.cluster.ray_backend")
    backend.RayCluster = None
    monkeypatch.setitem(sys.modules, backend.__name__, backend)
    monkeypatch.setattr(cluster, "check_available", lambda: None)
    monkeypatch.setattr(cluster, "_free_port", lambda: 6379)
    monkeypatch.setattr(cluster, "_log_file", lambda: tmp_path / "log")
    monkeypatch.setattr(cluster, "Node", node)
    opened = cluster.opened_cluster("local", token=tmp_path / "token", mixed=False)
    with pytest.raises(ClusterError, match="enough"), opened:
        pass
    assert "Ray listens on every address of this machine, not only on 127.0.0.2" in warning
    assert "docs/cluster.md" in warning


@needs_ray
@pytest.mark.ray
@pytest.mark.slow
def test_cluster_can_be_started_used_and_stopped_and_leaves_no_process(tmp_path):
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
            assert line, "the head ended"
            lines.append(line)
        result = json.loads("".join(lines))
        assert result["address"] == f"127.0.0.2:{port}"
        status = _run(tmp_path, "cluster", "status", result["address"], "--json")
        assert status.returncode == 0, status.stderr
        [member] = json.loads(status.stdout)["members"]
        assert member["ip"] == "127.0.0.2" and member["renderers"] == 1 and not member["busy"]
        used = subprocess.Popen(
            [*COMMAND, "open", "--cluster", result["address"], "--no-browser", "--json"],
            env=_environment(tmp_path),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert used.stdout.readline().startswith("{")
        finally:
            used.send_signal(signal.SIGINT)
            _, message = used.communicate(timeout=240)
        assert used.returncode == 0, message
        tree = descendants(head.pid)
        assert tree
    finally:
        head.send_signal(signal.SIGTERM)
        head.communicate(timeout=240)
    assert not [pid for pid, began in tree.items() if _began(pid) == began], "processes still run"
