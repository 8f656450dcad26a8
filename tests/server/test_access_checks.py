"""Tests of the access rules of the gate: hosts, origins, tokens, cookies and secrets."""

from __future__ import annotations

import pytest

from carina.server.network.access_checks import Gate, host_allowed, is_loopback

GOOD = {"host": "127.0.0.1:8123"}


@pytest.fixture
def gate():
    return Gate(host="127.0.0.1", port=8123)


@pytest.mark.parametrize("host", ["127.0.0.1:8123", "localhost:8123", "LOCALHOST:8123", "[::1]:8123", "127.0.0.2:8123"])
def test_server_on_loopback_allows_host_names_of_loopback(host):
    assert host_allowed(host, bound_host="127.0.0.1", port=8123)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example:8123",
        "127.0.0.1",
        "127.0.0.1:80",
        "127.0.0.1.evil.example:8123",
        "localhost.evil.example:8123",
        "192.168.1.5:8123",
        "127.0.0.1:8123:8123",
        "[::1:8123",
        "[::1]x:8123",
        "127.0.0.1:８１２３",  # This port has full-width digits.
        "127.0.0.1:-8123",
    ],
)
def test_server_on_loopback_refuses_other_host_names(host):
    assert not host_allowed(host, bound_host="127.0.0.1", port=8123)


def test_server_on_the_network_allows_literal_addresses_and_refuses_other_names():
    assert host_allowed("192.168.1.5:8123", bound_host="0.0.0.0", port=8123)
    assert host_allowed("workstation.lan:8123", bound_host="workstation.lan", port=8123)
    assert not host_allowed("evil.example:8123", bound_host="0.0.0.0", port=8123)


def test_only_addresses_of_this_computer_count_as_loopback():
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("example.org")


def test_access_token_of_the_start_link_is_redeemed_only_once_and_known_as_used(gate):
    token, other = gate.new_token(), gate.new_token()
    assert not gate.redeem("wrong")
    assert not gate.is_used(token)
    assert gate.redeem(token)
    assert not gate.redeem(token)
    assert gate.is_used(token)
    assert not any(gate.is_used(one) for one in ("wrong", "", "\u00fc", other))


def test_cookie_of_a_browser_on_this_machine_outlives_the_browser_and_has_the_same_limits(gate):
    assert "Max-Age" not in gate.set_cookie
    assert gate.set_lasting_cookie == f"{gate.set_cookie}; Max-Age=2592000"


def test_access_cookie_allows_requests_and_its_name_contains_the_port(gate):
    pair = gate.set_cookie.split(";")[0]
    assert gate.authorised({"cookie": f"other=1; {pair}"})
    assert not gate.authorised({"cookie": pair[:-1] + "A" if pair[-1] != "A" else pair[:-1] + "B"})
    assert not Gate(host="127.0.0.1", port=9).authorised({"cookie": pair})
    assert "HttpOnly" in gate.set_cookie
    assert "SameSite=Strict" in gate.set_cookie


def test_access_secret_allows_requests_of_programs_and_differs_from_the_cookie(gate):
    assert gate.authorised({"authorization": f"Bearer {gate.secret}"})
    assert not gate.authorised({"authorization": gate.secret})
    assert not gate.authorised({"authorization": "Bearer ü"})
    cookie_value = gate.set_cookie.split(";")[0].split("=")[1]
    assert not gate.authorised({"authorization": f"Bearer {cookie_value}"})
    assert not gate.authorised({})


@pytest.mark.parametrize("cookie", ["\0", "=;=;", "a" * 100_000, 'carina_8123="', "carina_8123=é"])
def test_malformed_access_cookies_are_ignored(gate, cookie):
    assert not gate.authorised({"cookie": cookie})


def test_get_request_needs_no_origin_header_and_a_websocket_needs_one(gate):
    assert gate.refusal(method="GET", headers=GOOD) is None
    assert gate.refusal(method=None, headers=GOOD) is not None
    assert gate.refusal(method="POST", headers=GOOD) is not None
    assert gate.refusal(method=None, headers=GOOD | {"authorization": f"Bearer {gate.secret}"}) is None


@pytest.mark.parametrize("method", ["GET", "POST", "PUT", None])
@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "", "https://127.0.0.1:8123", "http://127.0.0.1:8124", "http://localhost:8123"],
)
def test_request_from_another_origin_is_refused_despite_valid_credentials(gate, method, origin):
    headers = GOOD | {"origin": origin, "cookie": gate.set_cookie.split(";")[0]}
    assert gate.refusal(method=method, headers=headers) == "the request comes from another page"


def test_origin_header_of_the_server_itself_is_allowed(gate):
    assert gate.refusal(method=None, headers=GOOD | {"origin": "http://127.0.0.1:8123"}) is None
    assert gate.refusal(method=None, headers={"host": "localhost:8123", "origin": "http://localhost:8123"}) is None
