"""Membership of this machine in a cluster: Ray's environment variables, the token, and the process that runs Ray.

Nothing in this file imports Ray. Nothing calls ``ray stop``, because that would end all Ray processes of the user, also
those of other programs.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from carina.disk import make_folder, open_regular, write_whole
from carina.errors import ClusterError, UsageError
from carina.installation import extra_command

DEFAULT_PORT = 6379
TOKEN_NAME = "cluster.token"
STARTED = "Ray runtime started"
"""Line that Ray prints after the machine has joined a cluster."""
CONSOLE_ENVIRONMENT = {"RAY_gcs_rpc_server_reconnect_timeout_s": str(10 * 365 * 86_400)}
"""Names of Ray's environment variables that are set only in the process of the console.

Without them, Ray ends a program whose head node has been unreachable for a minute. The console then renders alone and
must go on. Other machines do end, and join again.
"""
TIMED_OUT = "timed out during startup"
"""Text that Ray prints if its own processes took too long to start."""
MIN_STORE_BYTES = 80 * 1024 * 1024


def check_available() -> None:
    """Raise an error with a remedy if this machine lacks what membership in a cluster requires, such as Ray.

    Raises
    ------
    ClusterError
        ``cluster.missing`` without Ray; ``cluster.platform`` if the system is not Linux.
    """
    if not sys.platform.startswith("linux"):
        msg = "a cluster needs Linux, the only system on which Ray supports clusters; render on this machine alone"
        raise ClusterError(msg, code="cluster.platform")
    if importlib.util.find_spec("ray") is None:
        command = extra_command("cluster")
        msg = f"rendering on several machines needs Ray, which is not installed; install it with: {command}"
        raise ClusterError(msg, code="cluster.missing")


def token_file(config_dir: Path) -> Path:
    """Return the default path of the token of the user's cluster."""
    return config_dir / TOKEN_NAME


def make_token(path: Path) -> Path:
    """Return the token file; if it is missing, create it with a new token, readable by its owner only."""
    if not path.exists():
        make_folder(path.parent, what="the token", private=True)
        write_whole(path, secrets.token_hex(32).encode(), what="the token", private=True)
    return check_token(path)


def check_token(path: Path) -> Path:
    """Check that a token file can be used, and return its path.

    Raises
    ------
    ClusterError
        ``cluster.token`` if the file is missing, too short, or readable by other users.
    """
    if not path.is_file():
        msg = (
            f"no token file at {path}; `carina cluster start --head` creates one on the head node: copy it to this "
            "machine, or give its path with --token-file"
        )
        raise ClusterError(msg, code="cluster.token")
    if path.stat().st_mode & 0o077:
        msg = (
            f"other users of this machine can read the token file {path}, and anyone who has the token can run "
            f"programs on this machine; run chmod 600 {path}"
        )
        raise ClusterError(msg, code="cluster.token")
    with open_regular(path) as file:
        token = file.read(4096).decode(encoding="ascii", errors="replace").strip()
    if len(token) < 16:
        raise ClusterError(f"the token in {path} is too short: expected 16 characters or more", code="cluster.token")
    return path


def ray_environment(token: Path, *, dedicated: bool = False) -> dict[str, str]:
    """Return the environment variables that Ray needs in each process before it is imported.

    Parameters
    ----------
    token
        The token file. A variable with the token itself would be readable in every worker's environment.
    dedicated
        Whether the machine is used for rendering only; renderers then run at full priority.
    """
    return {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN_PATH": str(token),
        "RAY_USAGE_STATS_ENABLED": "0",
        # Answers up to 1 MiB are returned directly: 400 KB between machines then take 1.2 ms instead of 9.4 ms.
        "RAY_max_direct_call_object_size": "1048576",
        # A dead renderer is reported after 0.3 to 1 s instead of 2 s, a disconnected machine after 6 to 8 s instead of
        # a minute. Carina's own deadlines act earlier; shorter times here would declare busy machines dead.
        "RAY_timeout_ms_task_wait_for_death_info": "50",
        "RAY_grpc_client_check_connection_status_interval_milliseconds": "200",
        "RAY_health_check_initial_delay_ms": "2000",
        "RAY_health_check_period_ms": "1000",
        "RAY_health_check_timeout_ms": "2000",
        "RAY_health_check_failure_threshold": "3",
        "RAY_task_events_report_interval_ms": "0",
        "RAY_enable_metrics_collection": "0",
        # On a workstation the user's programs have priority; Ray's default of 15 would be too low a priority.
        "RAY_worker_niceness": "0" if dedicated else "5",
    }


def own_address(towards: str | None = None) -> str:
    """Return the address of this machine on the network, as another machine would reach it.

    Parameters
    ----------
    towards
        Address of the other machine; None selects an address outside the local networks.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # A datagram socket sends nothing on connect; the kernel only selects the address.
            probe.connect((towards or "192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.2"


def split_address(address: str) -> tuple[str, int]:
    """Return the host and the port of an address ``HOST[:PORT]``; a missing port is replaced by the default."""
    host, _, port = address.partition(":")
    if not host or (port and not port.isdecimal()):
        raise UsageError(f"expected a cluster address HOST or HOST:PORT, such as 10.0.0.5:6379; found {address!r}")
    return host, int(port) if port else DEFAULT_PORT


class Node:
    """The process that keeps this machine in a cluster: ``ray start --block``, in its own process session.

    Parameters
    ----------
    token
        The token file.
    head
        Whether this is the first machine; otherwise ``address`` names the head.
    address
        ``HOST:PORT`` of the head.
    ip
        Address of this machine in the cluster's network.
    port
        Port of the head.
    renderers
        Number of renderers on this machine: 1, which uses all cores, or 0 for a console without a renderer.
    store_bytes
        Shared memory for volumes in bytes; None selects a quarter of the machine's memory, from 512 MiB to 8 GiB,
        limited to the free shared memory.
    dedicated
        As in :func:`ray_environment`.
    temp_dir, environment, command_prefix
        For tests.
    log
        File for the output of Ray.

    Raises
    ------
    ClusterError
        As in :func:`check_available` and :func:`check_token`.
    UsageError
        If both or neither of ``head`` and ``address`` are given.
    """

    def __init__(
        self,
        token: Path,
        *,
        head: bool = False,
        address: str | None = None,
        ip: str | None = None,
        port: int = DEFAULT_PORT,
        renderers: int = 1,
        store_bytes: int | None = None,
        dedicated: bool = False,
        temp_dir: Path | None = None,
        environment: Mapping[str, str] | None = None,
        command_prefix: tuple[str, ...] = (),
        log: Path | None = None,
    ) -> None:
        check_available()
        check_token(token)
        if head == (address is not None):
            raise UsageError("a machine can either start a cluster or join one, not both")
        arguments = ["start", "--block", "--disable-usage-stats", "--num-cpus=0"]
        # Without the log monitor and the autoscaler, which Carina does not need, Ray starts two processes fewer. Each
        # takes 1.2 s of a core at the start.
        arguments += ["--include-log-monitor=false"]
        if head:
            ip = ip or own_address()
            self.address = f"{ip}:{port}"
            arguments += ["--head", f"--port={port}", "--include-dashboard=false", "--no-monitor"]
        else:
            assert address is not None
            host, head_port = split_address(address)
            ip = ip or own_address(host)
            self.address = f"{host}:{head_port}"
            arguments += [f"--address={self.address}"]
        self.ip = ip
        arguments += [f"--node-ip-address={ip}", f"--object-store-memory={store_bytes or _usual_store_bytes()}"]
        if renderers:
            arguments += [f"--resources={json.dumps({'renderer': renderers})}"]
        if temp_dir is not None and head:
            arguments += [f"--temp-dir={temp_dir}"]
        where = {**os.environ, **ray_environment(token, dedicated=dedicated), **(environment or {})}
        self._log = None if log is None else log.open("ab")
        self._log_path = log
        self._starts_left = 3
        self._command = [*command_prefix, sys.executable, "-m", "ray.scripts.scripts", *arguments]
        self._environment = where
        self.process = self._start_process()

    def _start_process(self) -> subprocess.Popen[bytes]:
        self._starts_left -= 1
        self._log_from = 0 if self._log_path is None else self._log_path.stat().st_size
        return subprocess.Popen(
            self._command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=self._log or subprocess.DEVNULL,
            stderr=subprocess.STDOUT if self._log else subprocess.DEVNULL,
            start_new_session=True,
        )

    @property
    def running(self) -> bool:
        """Whether the process that keeps this machine in the cluster is running."""
        return self.process.poll() is None

    def wait_ready(self, timeout_s: float = 150.0) -> None:
        """Wait until the port of the head answers and this machine has joined.

        Raises
        ------
        ClusterError
            ``cluster.start`` if the process ended, or nothing answers in time.
        """
        host, port = split_address(self.address)
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            # Read once, because the process may end between two reads.
            has_ended = not self.running
            if has_ended and self._starts_left and TIMED_OUT in self._log_excerpt():
                # Ray requires its own processes to answer within 15 s, without a setting for this time, so a busy
                # machine retries.
                self.process = self._start_process()
            elif has_ended:
                raise ClusterError(
                    f"joining the cluster at {self.address} failed{self._last_log_lines()}", code="cluster.start"
                )
            with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=1.0):
                # The head's port answers before this machine has joined.
                if self._log_path is None or STARTED in self._log_excerpt():
                    return
            time.sleep(0.1)
        raise ClusterError(f"no answer from {self.address} within {timeout_s:g} s", code="cluster.start")

    def _log_excerpt(self) -> str:
        if self._log_path is None:
            return ""
        return self._log_path.read_bytes()[self._log_from :].decode("utf-8", errors="replace")

    def _last_log_lines(self) -> str:
        if self._log_path is None:
            return ""
        lines = self._log_excerpt().strip().splitlines()
        return f": {lines[-1].strip()}" if lines else ""

    def stop(self, grace_s: float = 10.0) -> None:
        """Leave the cluster: end the process and its descendants, by their process ids.

        Parameters
        ----------
        grace_s
            Time in seconds after which the process is killed.
        """
        tree = descendants(self.process.pid)
        if self.running:
            self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        end_processes(tree)
        if self._log is not None:
            self._log.close()


def _usual_store_bytes() -> int:
    """Return the default size of the shared memory for volumes in bytes."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    free = 0
    with contextlib.suppress(OSError):
        found = os.statvfs("/dev/shm")
        free = found.f_frsize * found.f_bavail
    wanted = max(512 * 1024 * 1024, min(total // 4, 8 * 1024**3))
    # Objects that exceed the shared memory would be written to the disk, which is slow.
    return max(MIN_STORE_BYTES, min(wanted, int(free * 0.9)) if free else wanted)


def _parents() -> dict[int, tuple[int, str]]:
    """Return for each process id of this machine the parent's process id and the start time of the process."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError, IndexError, ValueError):
                fields = (entry / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
                found[int(entry.name)] = (int(fields[1]), fields[19])
    return found


def descendants(pid: int) -> dict[int, str]:
    """Return the descendants of a process with their start times, because process ids are reused."""
    parents = _parents()
    tree: dict[int, str] = {}
    level = {pid}
    while level:
        level = {child for child, (parent, _) in parents.items() if parent in level and child not in tree}
        tree |= {child: parents[child][1] for child in level}
    return tree


def end_processes(tree: Mapping[int, str], grace_s: float = 5.0) -> None:
    """End those processes of a tree that still run; some of Ray's agents survive the end of their parent by minutes.

    Parameters
    ----------
    tree
        Process ids and start times from :func:`descendants`.
    grace_s
        Time in seconds after which the remaining processes are killed.
    """
    end_s = time.monotonic() + grace_s
    sent = False
    while left := {pid for pid, (_, began) in _parents().items() if tree.get(pid) == began}:
        if time.monotonic() > end_s:
            for pid in left:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            if sent:
                return
            sent, end_s = True, time.monotonic() + 2.0
        time.sleep(0.05)
