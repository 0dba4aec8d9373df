"""rpc_factory: a program on the simulated robot calls the functions of an XML-RPC server."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.program import script_rpc
from crtk_sim_backends.ur.urscript import ScriptRuntimeError
from rigs.ur_clients import PrimaryClient


class Server:
    """An XML-RPC server that keeps what it was called with."""

    def __init__(self) -> None:
        self._server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self._server.register_function(self.echo)
        self._server.register_function(self.add, "math.add")
        self._server.register_function(self.wait)
        self._server.register_function(lambda: None, "nothing")
        self.port = self._server.server_address[1]
        self.calls: list[Any] = []
        self.go_on = threading.Event()
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,))
        self._thread.start()

    def echo(self, value: Any) -> Any:
        self.calls.append(value)
        return value

    def add(self, a: Any, b: Any) -> Any:
        return a + b

    def wait(self) -> bool:
        return self.go_on.wait(20)

    def close(self) -> None:
        self.go_on.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.close()


@pytest.fixture(scope="module")
def sim() -> Iterator[Any]:
    with SIM.spawn(version="5.26") as running:
        yield running


def start(sim: Any, url: str, *lines: str) -> PrimaryClient:
    body = "\n".join(f"  {line}" for line in lines)
    primary = PrimaryClient(sim.host)
    primary.send(f'def p():\n  s = rpc_factory("xmlrpc", "{url}")\n{body}\nend\n'.encode())
    return primary


@pytest.mark.parametrize(
    ("value", "sent", "text"),
    [
        ("7", 7, "7"),
        ("-2.5", -2.5, "-2.5"),
        ("True", True, "True"),
        ('"a text"', "a text", "a text"),
        ("[1, 2]", [1, 2], "[1,2]"),
        (
            "p[1, 2, 3, 0.5, 0, 0]",
            {"x": 1, "y": 2, "z": 3, "rx": 0.5, "ry": 0, "rz": 0},
            "p[1,2,3,0.5,0,0]",
        ),
        ("struct(a=1, b=[2])", {"a": 1, "b": [2]}, "struct(a=1,b=[2])"),
    ],
)
def test_values_go_there_and_back(sim, server, value, sent, text) -> None:
    url = f"http://127.0.0.1:{server.port}/RPC2"
    with start(sim, url, f"textmsg(s.echo({value}))") as primary:
        assert primary.message(0).decode() == text
    assert server.calls == [sent]


def test_names_with_dots_and_the_end_of_a_connection(sim, server) -> None:
    lines = ("textmsg(s.math.add(1, 2))", "s.closeXMLRPCClientConnection()", "textmsg(s.echo(3))")
    with start(sim, f"127.0.0.1:{server.port}", *lines) as primary:
        assert primary.message(0) == b"3"
        assert primary.message(0) == b"3"


def test_a_slow_server_holds_up_its_thread_alone(sim, server) -> None:
    lines = (
        "thread t():",
        "  textmsg(s.wait())",
        "end",
        "h = run t()",
        "sleep(0.1)",
        'textmsg("meanwhile")',
        "join h",
    )
    with start(sim, f"http://127.0.0.1:{server.port}", *lines) as primary:
        assert primary.message(0) == b"meanwhile"
        server.go_on.set()
        assert primary.message(0) == b"True"


@pytest.mark.parametrize(
    ("url", "call", "text"),
    [
        ("http://127.0.0.1:{port}", "s.missing(1)", "Remote call missing failed: "),
        ("http://127.0.0.1:1", "s.echo(1)", "Remote call echo failed: ConnectionRefusedError"),
        ("http://127.0.0.1:{port}", "s.echo(a=1)", "Type error: echo is remote"),
        ("http://127.0.0.1:{port}", "s.echo(s)", "Type error: a value that cannot be sent"),
        ("file:///etc/passwd", "s.echo(1)", "rpc_factory: file:///etc/passwd is no address"),
    ],
)
def test_a_call_that_fails_stops_the_program(sim, server, url, call, text) -> None:
    with start(sim, url.format(port=server.port), "sleep(0.01)", call) as primary:
        message = primary.message(10).decode("utf-8", "replace")
    assert text in message


def run_to_its_end(call: Iterator[None]) -> None:
    for _ in call:
        time.sleep(0.001)


def test_a_server_that_does_not_answer_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script_rpc, "CALL_SECONDS", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        rpc = script_rpc.ScriptRpc("127.0.0.1")
        port = listener.getsockname()[1]
        server = rpc.rpc_factory("xmlrpc", f"127.0.0.1:{port}")
        call = server.call("wait", (), {})
        with pytest.raises(ScriptRuntimeError, match="Remote call wait failed: no answer"):
            run_to_its_end(call)


def test_calls_under_way_have_a_limit() -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=50) as listener:
        rpc = script_rpc.ScriptRpc("127.0.0.1")
        server = rpc.rpc_factory("xmlrpc", f"127.0.0.1:{listener.getsockname()[1]}")
        calls = [server.call("wait", (), {}) for _ in range(script_rpc.CALL_LIMIT + 1)]
        for call in calls[:-1]:
            next(call)
        with pytest.raises(ScriptRuntimeError, match="more than 16 remote calls under way"):
            next(calls[-1])
