"""The dashboard as a node with a web server: `ros2 run backlash_ros dashboard`."""

import asyncio
import os
import secrets
import signal
import socket
import sys
from collections.abc import AsyncIterator, Sequence
from concurrent.futures import Executor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Literal

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from backlash_ros.nodes.fixed_parameters import DashboardParameters, declare_dashboard, refuse_unknown
from backlash_ros.ros.aside import KINDER, InTurn
from backlash_ros.ros.overrides import parameter_rules
from backlash_ros.ros.run import help_of
from backlash_ros.ros.transport import avoid_shared_memory

NEEDS = 'the dashboard needs NiceGUI: pip install "backlash_ros[page]"'
_LAST = 5.0
"""Time for pages to disconnect when the server ends, s."""
_BACK = 30.0
"""Time for which a page without connection is kept, s; later it starts anew."""


def _listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; ValueError names the wrong parameter."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise ValueError(f"host must be an address of this machine, got {host!r}: {error.strerror}") from error
    listening = socket.socket(family, kind, protocol)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(address)
        listening.listen()  # who comes before the pages are there waits
    except OSError as error:
        listening.close()
        raise ValueError(f"cannot serve at host {host!r}, port {port}: {error.strerror}; port 0 is any") from error
    return listening


def _names(host: str, port: int) -> set[str]:
    """Return the accepted values of the Host header; empty if the server uses all addresses of the machine."""
    shown = f"[{host}]" if ":" in host else host
    if host in {"0.0.0.0", "::"}:  # noqa: S104 - compared, not served at
        return set()
    return {f"{name}:{port}" for name in (shown, "localhost", "127.0.0.1", "[::1]")}


async def _send_samples(connection: Any, station: Any, axis: str) -> None:
    """Send the samples of an axis over a web socket until it disconnects."""
    from backlash_ros.dashboard.station import Watcher  # noqa: PLC0415 - of the extra `page`
    from backlash_ros.ros.aside import give_way  # noqa: PLC0415

    await connection.accept()
    watcher = Watcher()
    watchers = station.of(axis).watchers
    watchers.add(watcher)

    async def send() -> None:
        while True:
            await connection.send_bytes(await watcher.get())
            give_way()

    sending = asyncio.create_task(send())
    try:
        while (await connection.receive())["type"] != "websocket.disconnect":
            pass
    finally:
        sending.cancel()
        watchers.discard(watcher)


def build(given: DashboardParameters, station: Any, names: set[str], token: str) -> Any:
    """Return the web application: pages, samples, stop and certificates, behind the guard."""
    from fastapi import FastAPI, WebSocket  # noqa: PLC0415 - of the extra `page`
    from fastapi.responses import FileResponse, PlainTextResponse  # noqa: PLC0415
    from fastapi.staticfiles import StaticFiles  # noqa: PLC0415
    from nicegui import Client, ui  # noqa: PLC0415

    from backlash_ros.dashboard.guard import Guard  # noqa: PLC0415
    from backlash_ros.dashboard.header import STATIC  # noqa: PLC0415
    from backlash_ros.dashboard.jog import SHARES, jog_while_told  # noqa: PLC0415
    from backlash_ros.dashboard.page import Page, static_folder  # noqa: PLC0415

    @asynccontextmanager
    async def life(_app: FastAPI) -> AsyncIterator[None]:
        sending = asyncio.create_task(station.run())
        yield
        sending.cancel()
        await station.close()

    web = FastAPI(lifespan=life, docs_url=None, redoc_url=None, openapi_url=None)
    web.mount(STATIC, StaticFiles(directory=static_folder()))

    @web.websocket("/samples")
    async def samples(connection: WebSocket, axis: str) -> None:
        await _send_samples(connection, station, axis)

    @web.get("/pages/{kind}")
    async def left_page(kind: str, axis: str) -> Any:
        place = station.page(axis, kind)
        return FileResponse(place) if place else PlainTextResponse("there is none\n", status_code=404)

    if not given.read_only:

        @web.websocket("/jog")
        async def held(connection: WebSocket, axis: str, way: Literal["1", "-1"], share: float) -> None:
            if share in SHARES:
                await jog_while_told(connection, lambda hand: station.jog(axis, int(way), share, hand))

        @web.post("/stop")
        async def stop(axis: str) -> Any:
            answer = await station.stop(axis)
            return PlainTextResponse(answer.text, status_code=200 if answer.success else 503)

    @ui.page("/", title="backlash_ros")
    async def page(client: Client) -> None:
        shown = Page(station, given.read_only)
        shown.refresh()
        await client.connected()
        await shown.started()

    ui.run_with(
        web, title="backlash_ros", dark=None, tailwind=False, show_welcome_message=False, reconnect_timeout=_BACK
    )
    return Guard(web, names, token)


async def serve(node: Node, given: DashboardParameters, listening: socket.socket, starting: Executor) -> int:
    """Serve until a signal comes; return the exit code."""
    import uvicorn  # noqa: PLC0415 - of the extra `page`

    from backlash_ros.dashboard.graph import Graph  # noqa: PLC0415
    from backlash_ros.dashboard.guard import is_loopback  # noqa: PLC0415
    from backlash_ros.dashboard.station import Station  # noqa: PLC0415

    port = listening.getsockname()[1]
    needs_token = not is_loopback(given.host)
    token = given.token or (secrets.token_urlsafe(16) if needs_token else "")
    server: Any = None
    failed = False

    def broken() -> None:
        nonlocal failed
        failed = server.should_exit = True

    graph = Graph(node, asyncio.get_running_loop(), broken)
    web = build(given, Station(graph, Path(given.folder), starting), _names(given.host, port), token)
    config = uvicorn.Config(
        web,
        log_level="warning",
        ws="websockets-sansio",
        ws_per_message_deflate=False,  # numbers shrink little, and it is half the work
        lifespan="on",
        timeout_graceful_shutdown=int(_LAST),
    )
    server = uvicorn.Server(config)
    name = f"[{given.host}]" if ":" in given.host else given.host
    secret = f"/?token={token}" if token else ""
    print(f"http://{name}:{port}{secret}", flush=True)
    if needs_token:
        may = "see the page" if given.read_only else "see the page and move the drive"
        node.get_logger().warning(f"anyone with this address can {may}")
    try:
        await server.serve(sockets=[listening])
    finally:
        graph.close()
    return 1 if failed else 0


ABOUT = """\
Serves a page to watch drives, tune their controllers and stop them; it prints the address.

It finds every controller of the graph. Only this machine can see the page, unless the parameter host says otherwise;
then the address needs a token. read_only:=true shows everything and changes nothing.

example: ros2 run backlash_ros dashboard --ros-args -p port:=8081"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the dashboard; return 2 if it cannot start."""
    words = sys.argv[1:] if args is None else list(args)
    help_of("dashboard", ABOUT).parse_args(remove_ros_args(words))
    avoid_shared_memory()
    try:
        import nicegui  # noqa: F401, PLC0415 - of the extra `page`
    except ImportError:
        print(NEEDS, file=sys.stderr)
        return 2
    # Linux keeps a nice value for each thread; new threads and processes take their maker's. So the page and what hears
    # the topics are kinder than the loop, but a recorder that the page starts is not.
    starting = InTurn()
    starting.submit(os.getpid).result()
    os.nice(KINDER)
    # As Ctrl-C does; the server takes both while it runs, and raises them again when it has ended.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node("dashboard", cli_args=parameter_rules(words))
        try:
            given = declare_dashboard(node)
            refuse_unknown(node)
            listening = _listen(given.host, given.port)
        except (ValueError, ParameterException, InvalidParameterTypeException) as error:
            node.get_logger().fatal(f"cannot start: {error}")
            return 2
        with listening:
            return asyncio.run(serve(node, given, listening, starting))
    except KeyboardInterrupt:
        return 0
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    raise SystemExit(main())
