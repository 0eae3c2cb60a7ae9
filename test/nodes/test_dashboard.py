"""The dashboard beside real nodes, without a browser: who gets what, whom it obeys, and that it disturbs nobody."""

import signal
import time
from collections.abc import Callable

import numpy as np
import pytest
from graph import Lifecycle, Peer
from served import B, Button, Reader, Served, Start, System, begin
from std_msgs.msg import Float64MultiArray
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from backlash_ros.dashboard.rows import JOINT_COLUMNS


class TestOneDrive:
    """What leaves the nodes whole, beside the same ones."""

    @pytest.mark.grid
    def test_pages_get_every_sample_and_none_stops_another(self, system: System) -> None:
        served = system.served
        assert served.ask("GET", "/")[0] == 200
        readers = [Reader(served) for _ in range(4)]
        asleep = readers.pop()  # a browser that stands still
        while min(reader.span for reader in readers) < 2.0:
            for reader in readers:
                reader.read()
        for reader in readers:
            times = np.array([row[JOINT_COLUMNS.index("time")] for row in reader.samples])
            steps = np.diff(times) / 0.004
            assert np.all(steps > 0.5)  # in order, none twice
            assert np.allclose(steps, np.round(steps), atol=0.01)
            assert np.mean(steps > 1.5) < 0.01  # best effort: one may be lost
            assert reader.states
        asleep.read()
        for reader in (*readers, asleep):
            reader.close()

    def test_only_the_page_itself_may_stop(self, system: System) -> None:
        served, peer = system.served, system.peer
        Reader(served).close()
        own = f"http://{served.host}"
        for headers in ({}, {"Origin": "http://evil.example"}):
            assert served.ask("POST", "/stop?axis=/", **headers)[0] == 403
        assert served.ask("POST", "/stop?axis=/", Origin="http://evil.example", Host="evil.example")[0] == 421
        assert Lifecycle(peer, "controller").state == "active"
        assert served.ask("POST", "/stop?axis=/nowhere", Origin=own) == (503, "there is no axis /nowhere")
        assert peer.wait("the stop", lambda: served.ask("POST", "/stop?axis=/", Origin=own)[0] == 200)
        assert Lifecycle(peer, "controller").state == "inactive"

    def test_a_jog_ends_with_whatever_holds_the_button(self, system: System) -> None:
        """A page that says nothing more, one that is closed, and a dashboard that stands still."""
        served = system.served
        reader = Reader(served)

        def press() -> Button:
            button = Button(served)
            system.moved(0.3, button.hold)
            return button

        said_nothing = press()
        silent = system.stands()
        press().close()
        closed = system.stands()
        assert closed > silent + 0.3 - 1.5 * B  # a load that stands may rattle by that much
        button = press()
        served.process.signal(signal.SIGSTOP)
        try:
            frozen = system.loads[-1]
            assert system.stands() < frozen + 0.5
            for _ in range(10):
                button.hold()
        finally:
            served.process.signal(signal.SIGCONT)
        assert abs(system.stands() - system.stands()) < 1.5 * B  # what it was told meanwhile moves nothing
        said_nothing.close()
        button.close()
        reader.close()

    def test_only_the_page_itself_may_jog(self, system: System) -> None:
        host = system.served.host
        for origin, rest in ((None, ""), (f"http://{host}", "&share=7"), (f"http://{host}", "&share=0.1&way=2")):
            with pytest.raises(InvalidStatus):
                connect(f"ws://{host}/jog?axis=/&way=1{rest}", origin=origin, open_timeout=60)


@pytest.mark.corners(1)
@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL])
def test_a_dashboard_that_freezes_or_dies_stops_nobody(
    start: Start, peer: Peer, serve: Callable[..., Served], how: signal.Signals
) -> None:
    begin(start)
    served = serve()
    reader = Reader(served)
    reader.read()
    answered: list[float] = []
    peer.node.create_subscription(Float64MultiArray, "command", lambda _: answered.append(time.monotonic()), 1000)
    peer.wait("commands", lambda: len(answered) > 10)
    served.process.signal(how)
    count = len(answered)
    peer.wait("the loop to go on", lambda: len(answered) > count + 1000)
    gaps = np.diff(answered[count:])
    assert np.sum(gaps > 0.9) == 0  # shared memory would hold each publish up by 1 s
    if how == signal.SIGSTOP:
        served.process.signal(signal.SIGCONT)


def test_another_address_wants_its_token(peer: Peer, serve: Callable[..., Served]) -> None:
    served = serve("-p", "host:=0.0.0.0")
    token = served.address.partition("/?token=")[2]
    assert len(token) >= 20
    warning = "anyone with this address can see the page and move the drive"
    peer.wait("the warning", lambda: warning in served.process.output())
    assert served.ask("GET", "/")[0] == 403
    assert served.ask("GET", "/?token=wrong")[0] == 403
    assert served.ask("GET", f"/?token={token}")[0] == 303
    assert served.ask("GET", "/", Cookie=f"backlash_ros_token={token}")[0] == 200


def test_it_ends_by_ctrl_c_with_pages_open(start: Start, peer: Peer, serve: Callable[..., Served]) -> None:
    begin(start)
    served = serve()
    reader = Reader(served)
    reader.read()
    assert served.process.stop() == 0
    assert "Traceback" not in served.process.output()


@pytest.mark.parametrize(
    ("rule", "says"),
    [
        ("port:=70000", "port must be"),
        ("host:=no.such.host.invalid", "host must be an address of this machine, got 'no.such.host.invalid'"),
        ("ports:=1", "there is no parameter 'ports', got 1: did you mean 'port'?"),
        ("read_only:=3", "read_only must be true or false"),
    ],
)
def test_a_start_that_is_not_understood_is_refused_in_one_line(start: Start, rule: str, says: str) -> None:
    process = start("dashboard", "-p", rule)
    assert process.wait() == 2
    assert says in process.output()
    assert process.output().count("\n") == 1


def test_a_port_that_is_taken_is_said(start: Start, serve: Callable[..., Served]) -> None:
    port = serve().host.rpartition(":")[2]
    second = start("dashboard", "-p", f"port:={port}")
    assert second.wait() == 2
    assert f"cannot serve at host '127.0.0.1', port {port}: Address already in use; port 0 is any" in second.output()
