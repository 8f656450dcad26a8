"""``carina cluster``, and the cluster connection of ``carina open --cluster``."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from carina.cli.console import print_json, print_note, print_result
from carina.cluster import ClusterRenderer, Console
from carina.cluster.node import (
    DEFAULT_PORT,
    Node,
    check_available,
    check_token,
    make_token,
    own_address,
    split_address,
    token_file,
)
from carina.config import load_settings
from carina.disk import make_folder
from carina.errors import ClusterError, UsageError
from carina.render import ClusterStatus, Renderer, TransferFunction
from carina.session import RendererFactory
from carina.volume import Volume

LOCAL_IP = "127.0.0.2"
AGAIN_S = (1.0, 2.0, 5.0, 10.0)
_OPEN_PORTS_WARNING = (
    "Ray listens on every address of this machine, not only on {ip}, so anyone on its networks can reach its ports. "
    "The cluster token is sent unencrypted, and anyone who has it can run programs on this machine. Use a private "
    "network or a firewall (docs/cluster.md), or omit --cluster: a single machine is just as fast without it."
)


def _token(path: Path | None) -> Path:
    return token_file(load_settings().config_dir) if path is None else path


def _log_file() -> Path:
    return make_folder(load_settings().state_dir, what="the log", private=True) / "cluster.log"


@contextmanager
def _ends_by_signal() -> Iterator[None]:
    """Handle SIGTERM, which service supervisors send, like Ctrl-C, so that the machine leaves the cluster cleanly."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        print_note("left the cluster")
    finally:
        signal.signal(signal.SIGTERM, before)


def start(*, ip: str | None, port: int, renders: bool, dedicated: bool, token: Path | None, as_json: bool) -> int:
    """Run the head of a cluster until Ctrl-C."""
    check_available()
    with _ends_by_signal():
        node = Node(
            make_token(_token(token)),
            head=True,
            ip=ip,
            port=port,
            renderers=int(renders),
            dedicated=dedicated,
            log=_log_file(),
        )
        try:
            node.wait_ready()
            if as_json:
                print_json({"address": node.address, "token_file": str(_token(token))})
            else:
                print_result(
                    f"The cluster is at {node.address}. Copy the token file {_token(token)}",
                    "to each additional machine, and run there",
                    f"  carina cluster join {node.address}",
                    "and here, in another terminal",
                    f"  carina open PATH --cluster {node.address}",
                    "Traffic is not encrypted: use a private network (docs/cluster.md).",
                    "Press Ctrl-C to stop the cluster.",
                    flush=True,
                )
            while node.running:
                time.sleep(0.5)
            print_note(f"the cluster's head process stopped unexpectedly; see its log, {_log_file()}")
            return 1
        finally:
            node.stop()
    return 0


def join(address: str, *, ip: str | None, dedicated: bool, token: Path | None, as_json: bool) -> int:
    """Render for a cluster until Ctrl-C; after a lost connection, try to join again without a time limit."""
    check_available()
    found = check_token(_token(token))
    attempts = 0
    has_joined = False
    with _ends_by_signal():
        while True:
            node = Node(found, address=address, ip=ip, dedicated=dedicated, log=_log_file())
            try:
                node.wait_ready()
                began_s = time.monotonic()
                if has_joined:
                    print_note(f"this machine has rejoined the cluster at {address}")
                else:
                    has_joined = True
                    if as_json:
                        print_json({"address": node.address, "ip": node.ip})
                    else:
                        print_result(
                            f"This machine ({node.ip}) has joined the cluster at {node.address}. "
                            "Press Ctrl-C to leave it.",
                            flush=True,
                        )
                while node.running:
                    time.sleep(0.2)
                # After a lost connection the head declares this machine dead and its process ends.
                attempts = 1 if time.monotonic() - began_s > 60.0 else attempts + 1
                words = f"this machine was dropped from the cluster at {address}; rejoining"
            except ClusterError as error:
                if not has_joined:
                    raise
                attempts += 1
                words = f"{error}; trying again"
            finally:
                node.stop()
            pause_s = AGAIN_S[min(attempts, len(AGAIN_S)) - 1]
            print_note(f"{words} in {pause_s:g} s")
            time.sleep(pause_s)
    return 0


def status(address: str | None, *, token: Path | None, as_json: bool) -> int:
    """Print the members of a cluster."""
    from carina.cluster.ray_backend import read_cluster_machines

    check_available()
    address = address or f"{own_address()}:{DEFAULT_PORT}"
    host, port = split_address(address)
    members = read_cluster_machines(f"{host}:{port}", check_token(_token(token)), ip=_own_ip_towards(host))
    if as_json:
        print_json({"address": f"{host}:{port}", "members": members})
        return 0
    num = sum(m["renderers"] for m in members if m["alive"])
    print_result(f"{host}:{port}: {num} renderer{'s' if num != 1 else ''}")
    for member in members:
        state = "busy" if member["busy"] else "free"
        state = ("no renderer" if not member["renderers"] else state) if member["alive"] else "offline"
        print_result(f"  {member['ip']:<16} {state:<12} {member['store_bytes'] / 2**30:.1f} GiB for volumes")
    return 0


def _own_ip_towards(host: str) -> str:
    return host if host.startswith("127.") else own_address(host)


@dataclass(frozen=True, slots=True)
class OpenCluster:
    """Cluster that a workstation uses for rendering."""

    make_renderer: RendererFactory
    status: Callable[[], ClusterStatus]


@contextmanager
def opened_cluster(address: str | None, *, token: Path | None, mixed: bool) -> Iterator[OpenCluster | None]:
    """Provide the cluster of ``carina open --cluster`` until the workstation is closed; None without an address."""
    if address is None:
        for option, is_given in (("--mixed", mixed), ("--token-file", token is not None)):
            if is_given:
                raise UsageError(f"{option} only applies to a cluster; add --cluster ADDRESS")
        yield None
        return
    check_available()
    from carina.cluster.ray_backend import RayCluster

    node: Node | None = None
    console: Console | None = None
    cluster: RayCluster | None = None
    try:
        if address == "local":
            found = make_token(_token(token))
            print_note("starting a cluster with this machine only")
            print_note(_OPEN_PORTS_WARNING.format(ip=LOCAL_IP))
            node = Node(found, head=True, ip=LOCAL_IP, port=_free_port(), log=_log_file())
            node.wait_ready()
            where, ip = node.address, LOCAL_IP
        else:
            found = check_token(_token(token))
            host, port = split_address(address)
            where, ip = f"{host}:{port}", _own_ip_towards(host)
            if host != ip:
                # The workstation must also be a member of the cluster, but without a renderer.
                node = Node(found, address=where, renderers=0, log=_log_file())
                node.wait_ready()
        print_note(f"joining the cluster at {where}")
        console = Console()
        cluster = RayCluster(console, where, found, mixed=mixed, ip=ip)
        settings = load_settings()
        shown = console

        def make_renderer(volume: Volume, transfer: TransferFunction) -> ClusterRenderer:
            renderer = Renderer(volume, transfer=transfer, cache_dir=settings.cache_dir / "maps")
            return ClusterRenderer(renderer, shown)

        yield OpenCluster(make_renderer, shown.status)
    finally:
        if cluster is not None:
            cluster.close()
        if console is not None:
            console.close()
        if node is not None:
            node.stop()


def _free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind((LOCAL_IP, 0))
        return int(probe.getsockname()[1])
