"""Remote procedure calls of URScript: ``rpc_factory`` and the functions of an XML-RPC server.

Source: URScript manual, "Remote Procedure Call (RPC)". A call runs in a thread of its own while the
script's thread waits, so that a slow server holds up nothing else; it has a deadline in real time.
"""

from __future__ import annotations

import http.client
import threading
import time
import urllib.parse
import xmlrpc.client
from collections.abc import Generator, Iterable, Sequence
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.ur.urscript import (
    Builtin,
    Handle,
    List,
    Pose,
    ScriptRuntimeError,
    Struct,
)

CALL_SECONDS: Final = 10.0  # real time that a server may take to answer
CALL_LIMIT: Final = 16  # calls under way at a time, those of ended programs included
_POSE: Final = ("x", "y", "z", "rx", "ry", "rz")
_CLOSE: Final = "closeXMLRPCClientConnection"


class ScriptRpc:
    """The connections to XML-RPC servers of one simulated controller.

    Args:
        host: address of the robot, from which the connections leave.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self._calls: list[_Call] = []

    def builtins(self) -> Iterable[Builtin]:
        """Give the built-ins."""
        yield Builtin("rpc_factory", self.rpc_factory)

    def rpc_factory(self, type: str, url: str) -> RpcServer:
        """Return the handle of a server; `url` is ``http://host:port/path`` or ``host:port``.

        No connection is made before the first call.
        """
        if type != "xmlrpc":
            raise ScriptRuntimeError(f"rpc_factory: unknown type {type}, there is xmlrpc")
        return RpcServer(self, url if "://" in url else f"http://{url}")

    def call(self, url: str, name: str, arguments: Sequence[Any]) -> Generator[None, None, Any]:
        """Call a function of a server; resumed once a control period until it has answered."""
        self._calls = [call for call in self._calls if call.is_alive()]
        if len(self._calls) >= CALL_LIMIT:
            raise ScriptRuntimeError(f"{name}: more than {CALL_LIMIT} remote calls under way")
        call = _Call(self._host, url, name, [_outgoing(item) for item in arguments])
        self._calls.append(call)
        call.start()
        deadline = time.monotonic() + CALL_SECONDS
        while call.is_alive():
            if time.monotonic() > deadline:
                raise ScriptRuntimeError(f"Remote call {name} failed: no answer")
            yield
        if call.error is not None:
            raise ScriptRuntimeError(f"Remote call {name} failed: {call.error}")
        return _incoming(call.result)


class RpcServer(Handle):
    """Handle of a server: any function of it can be called, ``server.a.b(1)`` calls ``a.b``."""

    def __init__(self, rpc: ScriptRpc, url: str, path: str = "") -> None:
        self._rpc = rpc
        self._url = url
        self._path = path

    def __getattr__(self, member: str) -> RpcServer:
        if not member.startswith("m_"):
            raise AttributeError(member)
        return RpcServer(self._rpc, self._url, f"{self._path}{member[2:]}.")

    @override
    def call(
        self, name: str, arguments: Sequence[Any], keywords: dict[str, Any]
    ) -> Generator[None, None, Any]:
        """Call a function of the server; closing the connection is none of the server's."""
        if keywords:
            raise ScriptRuntimeError(f"Type error: {name} is remote and takes no named arguments")
        if name == _CLOSE:
            return None  # each call has a connection of its own
        return (yield from self._rpc.call(self._url, self._path + name, arguments))


class _Call(threading.Thread):
    """One call. A daemon, because the end of the process must not wait for a server."""

    def __init__(self, host: str, url: str, name: str, arguments: list[Any]) -> None:
        super().__init__(name=f"remote call {name}", daemon=True)
        self._url = urllib.parse.urlsplit(url)
        if self._url.scheme != "http" or not self._url.hostname:
            raise ScriptRuntimeError(f"rpc_factory: {url} is no address such as http://host:port")
        self._transport = _Transport(host)
        self._function = name
        self._arguments = tuple(arguments)
        self.result: Any = None
        self.error: str | None = None

    @override
    def run(self) -> None:
        """Call, keep result or error, close the connection."""
        try:
            request = xmlrpc.client.dumps(self._arguments, self._function)
            path = self._url.path or "/RPC2"
            reply = self._transport.request(self._url.netloc, path, request.encode())
            self.result = reply[0] if len(reply) == 1 else list(reply)
        except xmlrpc.client.Fault as error:
            self.error = error.faultString
        except Exception as error:  # whatever the server sent: the script is told
            self.error = f"{type(error).__name__}: {error}"
        finally:
            self._transport.close()


class _Transport(xmlrpc.client.Transport):
    """HTTP from the address of the robot, with a deadline."""

    def __init__(self, host: str) -> None:
        super().__init__(use_builtin_types=True)
        self._source = host

    @override
    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        """Connect, new each time."""
        address, self._extra_headers, _ = self.get_host_info(host)
        connection = http.client.HTTPConnection(
            address, timeout=2 * CALL_SECONDS, source_address=(self._source, 0)
        )
        self._connection = host, connection
        return connection


def _outgoing(value: Any) -> Any:
    """Turn a value of a script into one of XML-RPC; a pose is a struct of x, y, z, rx, ry, rz."""
    if isinstance(value, Pose):
        return dict(zip(_POSE, map(float, value), strict=True))
    if isinstance(value, List):
        return [_outgoing(item) for item in value]
    if isinstance(value, Struct):
        return {name: _outgoing(item) for name, item in value.items()}
    if isinstance(value, bool | int | float | str):
        return value
    raise ScriptRuntimeError("Type error: a value that cannot be sent to a remote function")


def _incoming(value: Any) -> Any:
    if isinstance(value, dict):
        if set(value) == set(_POSE):
            return Pose([float(value[name]) for name in _POSE])
        return Struct((name, _incoming(item)) for name, item in value.items())
    if isinstance(value, list):
        return List([_incoming(item) for item in value])
    if isinstance(value, bool | int | float | str) or value is None:
        return value
    raise ScriptRuntimeError(f"Type error: a remote function returned {type(value).__name__}")
