"""The control socket of a simulator: inject faults and read its state while it runs.

One JSON object a line, both ways. A request is ``{"do": name, "with": {...}}``; the answer is
``{"ok": true, "result": ...}`` or ``{"ok": false, "error": "..."}``. What can be done is the
table of handlers that the simulator gives; :class:`ControlClient` has a method for each that
every simulator has.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Final, Self

from crtk_sim_backends.faults import unknown

MAX_LINE: Final = 1 << 20

_WRONG_REQUEST: Final = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    OverflowError,  # numbers of hundreds of digits
    RecursionError,  # brackets nested thousands deep
)

Handlers = Mapping[str, Callable[..., Any]]


class ControlError(RuntimeError):
    """The simulator refused a request, or does not answer."""


class ControlSession:
    """Server side of one control connection: bytes in, bytes out."""

    ended = False

    def __init__(self, handlers: Handlers) -> None:
        self._handlers = handlers
        self._buffer = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Take received data and return the answers to the requests that it completes."""
        self._buffer += data
        answers = bytearray()
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            answers += json.dumps(self._answer(line)).encode() + b"\n"
        if len(self._buffer) > MAX_LINE:
            self._buffer.clear()
        return bytes(answers)

    def close(self) -> None:
        """Forget an unfinished line."""
        self._buffer.clear()

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            name, arguments = request["do"], request.get("with", {})
            if name not in self._handlers:
                raise ValueError(unknown("request", name, self._handlers))
            return {"ok": True, "result": self._handlers[name](**arguments)}
        except _WRONG_REQUEST as error:
            return {"ok": False, "error": f"{error}"}


class ControlClient:
    """Client side: one connection to the control socket of a simulator.

    Args:
        host: loopback address of the simulator.
        port: its control port.
        timeout: longest wait for an answer, s.

    Raises:
        ControlError: from every method, when the simulator refuses or does not answer.
    """

    def __init__(self, host: str, port: int, timeout: float = 5.0) -> None:
        self._name = f"simulator at {host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise ControlError(
                f"cannot reach the {self._name}: {error}; is it still running?"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rb")

    def call(self, do: str, **arguments: Any) -> Any:
        """Do any request by name and return its result."""
        request = json.dumps({"do": do, "with": arguments}).encode() + b"\n"
        try:
            self._socket.sendall(request)
            line = self._lines.readline()
        except OSError as error:
            raise ControlError(f"no answer to {do!r} from the {self._name}: {error}") from error
        if not line:
            raise ControlError(f"the {self._name} closed the control connection; it has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise ControlError(f"the {self._name} refused {do!r}: {answer['error']}")
        return answer["result"]

    def inject(self, kind: str, **parameters: Any) -> None:
        """Begin a fault; it is in force when this returns.

        Args:
            kind: kind of fault.
            parameters: as in a fault file, `duration` included.
        """
        self.call("inject", kind=kind, parameters=parameters)

    def clear(self, kind: str | None = None) -> None:
        """End a lasting fault, or all of them; they have ended when this returns."""
        self.call("clear", kind=kind)

    def status(self) -> dict[str, Any]:
        """State of the simulated device, its statistics, connections and last commands."""
        result: dict[str, Any] = self.call("status")
        return result

    def outputs(self, *names: str) -> dict[str, Any]:
        """Present values of the outputs of the device, all of them when no name is given."""
        result: dict[str, Any] = self.call("outputs", names=list(names))
        return result

    def trace(self, after: int = 0) -> list[dict[str, Any]]:
        """Last commands received, oldest first, from the one numbered `after` + 1 on.

        Each has `number`, `time_ns` (monotonic clock, when its bytes were read), `connection`,
        `recipe` and `values` (by name).
        """
        result: list[dict[str, Any]] = self.call("trace", after=after)
        return result

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._lines.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
