"""The control socket of a simulator: inject faults and read its state while it runs.

One JSON object a line, and one for an answer: ``{"ok": true, "result": ...}`` or ``{"ok": false, "error":
"..."}``. The first line is ``{"token": "..."}``, with what :func:`token` returns: whoever can read files of
this user may use it, and a page in this user's browser cannot. A connection that begins with anything else
is closed. Then each line is a request, ``{"do": name, "with": {...}}``. What can be done is the table of
handlers that the simulator gives; :class:`ControlClient` has a method for each that every simulator has.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import os
import secrets
import socket
import stat
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Self

from crtk_sim_backends.faults import unknown

MAX_LINE: Final = 1 << 20
MAX_FIRST_LINE: Final = 4096
_SHORTEST: Final = 16  # characters of a token in a file

TOKEN_VARIABLE: Final = "CRTK_SIM_TOKEN"
"""Environment variable that gives the token in place of the file."""

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


class ControlRefused(ControlError):
    """The simulator refused a request: it answers."""


def token_file() -> Path:
    """Where the token of this user's simulators is kept."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime and os.access(runtime, os.W_OK | os.X_OK):
        return Path(runtime, "crtk-sim", "token")
    return Path(tempfile.gettempdir(), f"crtk-sim-{os.getuid()}", "token")


def token() -> str:
    """Return the token of this user's simulators, which is made at the first use.

    Raises:
        ControlError: it cannot be kept where nobody else can read or change it.
    """
    given = os.environ.get(TOKEN_VARIABLE, "")
    if given:
        return given
    path = token_file()
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        _check_private(path.parent)
        if not path.exists():
            _write_once(path, secrets.token_hex(16))
        found = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ControlError(
            f"cannot keep the token of the simulators in {path}: {error}; give one with {TOKEN_VARIABLE}"
        ) from error
    if len(found) < _SHORTEST:
        raise ControlError(f"there is no token in {path}: remove that file")
    return found


def _check_private(place: Path) -> None:
    found = place.lstat()
    private = found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077
    if not (private and stat.S_ISDIR(found.st_mode)):
        raise ControlError(
            f"the token of the simulators is not safe in {place}, which others can read or write; "
            f"remove it, or give a token with {TOKEN_VARIABLE}"
        )


def _write_once(path: Path, text: str) -> None:
    """Write a file that only this user can read, unless somebody is first; never half of it."""
    own = path.with_name(f"token-{os.getpid()}-{secrets.token_hex(4)}")
    own.touch(mode=0o600, exist_ok=False)
    try:
        own.write_text(text + "\n", encoding="ascii")
        with contextlib.suppress(FileExistsError):
            os.link(own, path)
    finally:
        own.unlink()


_WHERE: Final = (
    f"in the file crtk-sim/token of the user who runs the simulator, or {TOKEN_VARIABLE}"
)


class ControlSession:
    """Server side of one control connection: bytes in, bytes out. `ended` asks for it to be closed.

    Args:
        handlers: what can be done, by name.
        secret: that the first line must name.
    """

    def __init__(self, handlers: Handlers, secret: str) -> None:
        self.ended = False
        self._handlers = handlers
        self._secret = secret
        self._known = False
        self._buffer = bytearray()

    def receive(self, data: bytes) -> bytes:
        """Take received data and return the answers to the requests that it completes."""
        if self.ended:
            return b""
        self._buffer += data
        first = b"" if self._known else self._take_first_line()
        return first + self._take_requests() if self._known else first

    def _take_first_line(self) -> bytes:
        """Let the client in, or end the connection; return the answer."""
        end = self._buffer.find(b"\n")
        if end < 0 and len(self._buffer) <= MAX_FIRST_LINE:
            return b""
        line = bytes(self._buffer[:end]) if 0 <= end <= MAX_FIRST_LINE else b""
        del self._buffer[: end + 1]
        try:
            first = json.loads(line)
        except _WRONG_REQUEST:
            first = None
        given = first.get("token") if isinstance(first, dict) else None
        if isinstance(given, str) and _same(given, self._secret):
            self._known = True
            return _line({"ok": True, "result": None})
        self.ended = True
        self._buffer.clear()
        if not isinstance(first, dict):
            return b""
        return _line({"ok": False, "error": f"the first line must have the token: {_WHERE}"})

    def _take_requests(self) -> bytes:
        answers = bytearray()
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            answers += _line(self._answer(line))
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


def _same(given: str, secret: str) -> bool:
    """Say whether they are, in a time that does not tell how much of it."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), secret.encode())


def _line(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value).encode() + b"\n"


class ControlClient:
    """Client side: one connection to the control socket of a simulator. Thread-safe.

    Args:
        host: loopback address of the simulator.
        port: its control port.
        timeout: longest wait for an answer, s.
        secret: the simulator's token, if it is not one of this user's.

    Raises:
        ControlError: from every method, when the simulator refuses or does not answer.
    """

    def __init__(
        self, host: str, port: int, timeout: float = 5.0, secret: str | None = None
    ) -> None:
        self._name = f"simulator at {host}:{port}"
        first = _line({"token": token() if secret is None else secret})
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise ControlError(
                f"cannot reach the {self._name}: {error}; is it still running?"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rb")
        self._lock = threading.Lock()
        self._let_in = False
        self.lost = False
        """Nothing more comes of it: a late answer would be taken for that to the next request."""
        with contextlib.suppress(OSError):  # the first request tells
            self._socket.sendall(first)

    def call(self, do: str, **arguments: Any) -> Any:
        """Do any request by name and return its result."""
        request = _line({"do": do, "with": arguments})
        with self._lock:
            if not self._let_in:
                self._read_answer(do)
                self._let_in = True
            try:
                self._socket.sendall(request)
            except OSError as error:
                self.lost = True
                raise ControlError(f"no answer to {do!r} from the {self._name}: {error}") from error
            return self._read_answer(do)

    def _read_answer(self, do: str) -> Any:
        try:
            line = self._lines.readline()
        except OSError as error:
            self.lost = True
            raise ControlError(f"no answer to {do!r} from the {self._name}: {error}") from error
        if not line:
            self.lost = True
            raise ControlError(f"the {self._name} closed the control connection; it has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise ControlRefused(f"the {self._name} refused {do!r}: {answer['error']}")
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
        with self._lock:
            with contextlib.suppress(OSError):
                self._lines.close()
            self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
