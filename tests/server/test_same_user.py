"""Tests of the check that a loopback connection comes from the user of the server."""

from __future__ import annotations

import os
import socket
import sys

import pytest

from carina.server.network.same_user import SOCKET_TABLES, comes_from_same_user

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="this system has no user numbers")

HEAD = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
CLIENT, SERVER = ("127.0.0.1", 40000), ("127.0.0.1", 8123)
LOOPBACK = "0100007F" if sys.byteorder == "little" else "7F000001"


def row(local, remote, user, state="01"):
    return f"   0: {local} {remote} {state} 00000000:00000000 00:00000000 00000000  {user}        0 1 1\n"


def of(tmp_path, *rows):
    path = tmp_path / "tcp"
    path.write_text(HEAD + "".join(rows), "ascii")
    return (path,)


def scope(client=CLIENT, server=SERVER):
    return {"client": client, "server": server}


ENDS = f"{LOOPBACK}:9C40", f"{LOOPBACK}:1FBB"
ME = os.getuid() if hasattr(os, "getuid") else 0


def test_socket_of_this_user_is_accepted_and_that_of_another_user_refused(tmp_path):
    # The table also contains the server's end of the connection, with the addresses exchanged.
    own = row(*reversed(ENDS), ME)
    assert comes_from_same_user(scope(), of(tmp_path, own, row(*ENDS, ME)))
    assert not comes_from_same_user(scope(), of(tmp_path, own, row(*ENDS, ME + 1)))


def test_missing_closed_or_ambiguous_sockets_are_refused(tmp_path):
    own = row(*reversed(ENDS), ME)
    assert not comes_from_same_user(scope(), of(tmp_path, own))
    assert not comes_from_same_user(scope(), of(tmp_path, row(*ENDS, ME, state="06")))
    assert not comes_from_same_user(scope(), of(tmp_path, row(*ENDS, ME), row(*ENDS, ME + 1)))
    assert not comes_from_same_user(scope(), of(tmp_path, row(ENDS[0], f"{LOOPBACK}:0050", ME)))
    assert not comes_from_same_user(scope(), (tmp_path / "absent",))
    assert not comes_from_same_user({"client": None, "server": SERVER}, of(tmp_path, row(*ENDS, ME)))
    assert not comes_from_same_user({"client": ("host", 1), "server": SERVER}, of(tmp_path, row(*ENDS, ME)))


def test_connection_from_another_machine_is_refused_even_if_the_socket_table_lists_it(tmp_path):
    tables = of(tmp_path, row(*ENDS, ME))
    assert not comes_from_same_user(scope(client=("192.168.1.5", 40000)), tables)
    assert not comes_from_same_user(scope(server=("192.168.1.5", 8123)), tables)


@pytest.mark.skipif(not SOCKET_TABLES[0].exists(), reason="only Linux shows the user of a socket")
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_real_loopback_connection_of_this_process_is_accepted(host):
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip("this machine has no IPv6 loopback")
    with listener, socket.create_connection(listener.getsockname()[:2]) as client:
        accepted, _ = listener.accept()
        with accepted:
            ends = {"client": client.getsockname()[:2], "server": client.getpeername()[:2]}
            assert comes_from_same_user(ends)
            assert not comes_from_same_user(ends | {"client": (host, 1)})
