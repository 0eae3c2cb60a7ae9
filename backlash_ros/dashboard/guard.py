"""Access control: checks every request before anything else sees it."""

import hmac
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from http.cookies import SimpleCookie
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "backlash_ros_token"
_READING = {"GET", "HEAD"}


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches ``host``, a name or an address."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Guard:
    """ASGI middleware that refuses requests without permission.

    The Host header must be one of ``hosts``: this prevents DNS rebinding. The Origin header, if there is one, must name
    the same host; requests that may change something, which are all but reads, must have one. Browsers send it, and no
    page can forge it. A ``token``, if set, is required once, as ``/?token=...``, and then kept as a cookie.

    Parameters
    ----------
    hosts : accepted values of the Host header, in lower case; empty for any
    token : empty for none
    """

    def __init__(self, app: App, hosts: Collection[str], token: str = "") -> None:
        self._app, self._hosts, self._token = app, hosts, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get("host", "").lower()
        if self._hosts and host not in self._hosts:
            await _refuse(scope, send, 421, f"this server does not serve the name {host!r}")
        elif not self._known(headers):
            if self._opens(scope):
                await _let_in(scope, send, self._token)
            else:
                text = "this page needs a token: open the address that the dashboard printed in its terminal"
                await _refuse(scope, send, 403, text)
        elif ("origin" in headers or _changes(scope)) and not _of_host(headers.get("origin", ""), host):
            await _refuse(scope, send, 403, "only the dashboard's own page may do this")
        else:
            await self._app(scope, receive, send)

    def _known(self, headers: dict[str, str]) -> bool:
        if not self._token:
            return True
        kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        return kept is not None and _equal(kept.value, self._token)

    def _opens(self, scope: Scope) -> bool:
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return scope["type"] == "http" and scope["method"] == "GET" and _equal(given, self._token)


def _equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _of_host(origin: str, host: str) -> bool:
    return origin.lower().partition("://")[2] == host


def _changes(scope: Scope) -> bool:
    """Return whether a request may change something."""
    return scope["type"] == "websocket" or scope["method"] not in _READING


async def _let_in(scope: Scope, send: Send, token: str) -> None:
    cookie = f"{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/"
    headers = [(b"location", scope["path"].encode()), (b"set-cookie", cookie.encode())]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, send: Send, status: int, text: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": text})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{text}\n".encode()})
