"""Tests of tokens, addresses, versions and messages of a cluster node; no Ray is started."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import pytest

from carina.cluster import node
from carina.cluster.ray_backend import RayLane, version_words
from carina.errors import ClusterError, UsageError


def test_cluster_token_is_created_once_and_readable_by_its_owner_only(tmp_path):
    made = node.make_token(tmp_path / "deep" / "token")
    text = made.read_text()
    assert made.stat().st_mode & 0o777 == 0o600
    assert len(text) == 64
    assert node.make_token(made).read_text() == text
    assert text != node.make_token(tmp_path / "other").read_text()


def test_token_file_readable_by_other_users_is_refused(tmp_path):
    made = node.make_token(tmp_path / "token")
    made.chmod(0o644)
    with pytest.raises(ClusterError, match="chmod 600"):
        node.check_token(made)


def test_message_about_a_missing_token_states_how_to_get_it(tmp_path):
    with pytest.raises(ClusterError, match="start --head"):
        node.check_token(tmp_path / "none")
    short = tmp_path / "short"
    short.touch(mode=0o600)
    with pytest.raises(ClusterError, match="too short"):
        node.check_token(short)


def test_message_about_the_missing_cluster_extra_states_its_installation_command(monkeypatch):
    monkeypatch.setattr(node.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(ClusterError, match=r"install .*'ray>=") as refused:
        node.check_available()
    assert refused.value.exit_code == 1


def test_cluster_on_other_systems_than_linux_is_refused_with_a_message(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(ClusterError, match="needs Linux"):
        node.check_available()


def test_environment_of_a_node_contains_no_token_and_disables_usage_reports(tmp_path):
    made = node.make_token(tmp_path / "token")
    environment = node.ray_environment(made)
    assert made.read_text() not in environment.values()
    assert environment["RAY_AUTH_MODE"] == "token"
    assert environment["RAY_USAGE_STATS_ENABLED"] == "0"
    assert node.ray_environment(made, dedicated=True)["RAY_worker_niceness"] == "0"


def test_kuberay_manifest_sets_the_same_environment_as_a_node(tmp_path):
    manifest = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text(encoding="utf-8")
    settings = dict(re.findall(r"\{name: (RAY_\w+), value: \"?([^\"}]+)\"?\}", manifest))
    ours = node.ray_environment(node.make_token(tmp_path / "token"), dedicated=True)
    assert settings == {**ours, "RAY_AUTH_TOKEN_PATH": "/etc/carina/token"}


@pytest.mark.parametrize(
    ("text", "starts", "message"), [(node.TIMED_OUT, 3, node.TIMED_OUT), ("no such option", 1, "no such option")]
)
def test_node_start_is_repeated_after_a_timeout_and_not_after_a_refusal(tmp_path, monkeypatch, text, starts, message):
    """Use a busy machine and an invalid argument.

    On a busy machine Ray's helper processes exceed a time limit; an invalid argument always fails.
    """
    monkeypatch.setattr(node, "check_available", lambda: None)
    log, began = tmp_path / "log", tmp_path / "began"
    program = f"open({str(began)!r}, 'a').write('x'); print({text!r})"
    made = node.Node(node.make_token(tmp_path / "token"), head=True, ip="127.0.0.2", port=1, log=log)
    made.stop()
    made._command, made._starts_left, made._log = [sys.executable, "-c", program], 3, log.open("ab")
    made.process = made._start_process()
    with pytest.raises(ClusterError, match=message):
        made.wait_ready(600.0)
    made.stop()
    assert began.read_text() == "x" * starts


def test_cluster_address_without_a_port_gets_the_default_port():
    assert node.split_address("10.0.0.5") == ("10.0.0.5", 6379)
    assert node.split_address("desk:7000") == ("desk", 7000)
    for bad in ("", ":7000", "desk:door"):
        with pytest.raises(UsageError, match="HOST:PORT"):
            node.split_address(bad)


FACTS = {"host": "m", "threads": 4, "simd": "avx2", "version": "0.1.0", "pid": 1}


@pytest.mark.parametrize(
    ("store_bytes", "new_bytes", "free_bytes", "text"),
    [
        (3 * 2**30, 0, None, "has only 3.0 GiB for volumes"),
        (8 * 2**30, 4 * 2**30, 4 * 2**30, "has only 4.0 GiB of free memory"),
    ],
)
def test_case_larger_than_the_memory_is_reported_with_available_and_needed_size(
    store_bytes, new_bytes, free_bytes, text
):
    lane = RayLane("m", None, None, FACTS, store_bytes)
    big = types.SimpleNamespace(num_bytes=4 * 2**30)
    with pytest.raises(ClusterError, match=text) as refused:
        lane._check_memory(big, new_bytes, free_bytes)
    assert refused.value.code == "cluster.memory"
    assert "the renderer m is not used" in str(refused.value) and "the case needs 4.0 GiB" in str(refused.value)
    # The store has exactly the needed size, and the free memory exceeds the new size.
    RayLane("m", None, None, FACTS, 4 * 2**30)._check_memory(big, 4 * 2**30, 5 * 2**30)


@pytest.mark.parametrize(
    ("console", "renderer", "side"),
    [("0.2.0", "0.1.9", "machine m"), ("0.2.0", "0.10.0", "this console"), ("1.0", "0.9.9", "machine m")],
)
def test_message_about_different_versions_names_the_older_computer(console, renderer, side):
    text = version_words(console, renderer, "m")
    assert text is not None and text.endswith(f"upgrade the {side}" if side != "this console" else f"upgrade {side}")
    assert version_words("0.2.0", "0.2.0", "m") is None
