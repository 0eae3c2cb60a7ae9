"""Who the dashboard's server lets in: every request that another page, another name or no token could send."""

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest

from backlash_ros.dashboard.guard import COOKIE, Guard, is_loopback

HERE = "127.0.0.1:8080"
OWN = f"http://{HERE}"


def ask(
    *headers: tuple[str, str], kind: str = "http", method: str = "GET", query: str = "", token: str = ""
) -> list[dict[str, Any]]:
    """Return what was sent in answer to one request; the application behind the guard answers 200."""
    sent: list[dict[str, Any]] = []

    async def application(_scope: Any, _receive: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": 200})

    async def send(message: Any) -> None:
        sent.append(dict(message))

    async def receive() -> Any:
        raise AssertionError("nothing is read before it is judged")

    scope = {
        "type": kind,
        "method": method,
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers],
    }
    asyncio.run(Guard(application, {HERE}, token)(scope, receive, send))
    return sent


def status(*headers: tuple[str, str], **request: str) -> int | str:
    first = ask(*headers, **request)[0]
    return first["status"] if first["type"] == "http.response.start" else first["type"]


def test_a_page_of_this_server_may_read_and_act() -> None:
    assert status(("host", HERE)) == 200
    assert status(("host", HERE), ("origin", OWN), method="POST") == 200
    assert status(("host", HERE), ("origin", OWN), kind="websocket") == 200


@pytest.mark.parametrize("origin", [(), ("http://evil.example",), ("null",), ("http://127.0.0.1:9999",)])
@pytest.mark.parametrize("request_", [{"method": "POST"}, {"method": "DELETE"}, {"kind": "websocket"}])
def test_no_other_page_changes_anything(origin: Sequence[str], request_: dict[str, str]) -> None:
    refused = status(("host", HERE), *(("origin", each) for each in origin), **request_)
    assert refused == ("websocket.close" if "kind" in request_ else 403)


def test_no_other_page_reads_anything() -> None:
    assert status(("host", HERE), ("origin", "http://evil.example")) == 403
    assert status(("host", HERE), ("origin", OWN)) == 200


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:8081", ""])
def test_no_other_name_leads_here(host: str) -> None:
    """A name that somebody points at this machine would make his page one of this server's."""
    assert status(("host", host), ("origin", f"http://{host}")) == 421


def test_the_token_is_asked_for_once_and_kept_from_scripts() -> None:
    assert status(("host", HERE), token="secret") == 403
    assert status(("host", HERE), token="secret", query="token=wrong") == 403
    assert status(("host", HERE), ("cookie", f"{COOKIE}=wrong"), token="secret") == 403
    assert status(("host", HERE), ("origin", OWN), token="secret", kind="websocket") == "websocket.close"
    opened = ask(("host", HERE), token="secret", query="token=secret")[0]
    assert opened["status"] == 303
    headers = {name.decode(): value.decode() for name, value in opened["headers"]}
    assert headers["location"] == "/"  # the secret leaves the address
    assert headers["set-cookie"] == f"{COOKIE}=secret; HttpOnly; SameSite=Strict; Path=/"
    kept = ("cookie", f"other=1; {COOKIE}=secret")
    assert status(("host", HERE), kept, token="secret") == 200
    assert status(("host", HERE), kept, method="POST", token="secret") == 403  # a cookie is no origin
    assert status(("host", HERE), kept, ("origin", OWN), method="POST", token="secret") == 200


@pytest.mark.parametrize("name", ["GET", "websocket"])
def test_a_secret_that_is_no_ascii_is_refused_like_any_other(name: str) -> None:
    kind = {"kind": "websocket"} if name == "websocket" else {}
    refused = status(("host", HERE), ("cookie", f"{COOKIE}=\u00e4"), token="secret", query="token=%C3%A4", **kind)
    assert refused in {403, "websocket.close"}


@pytest.mark.parametrize(
    ("host", "alone"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("192.168.0.2", False),
        ("robot.local", False),
    ],
)
def test_what_only_this_machine_reaches_is_known(host: str, alone: bool) -> None:
    assert is_loopback(host) is alone
