"""The web server of the fieldbus module: connections that stay, JSON of hexadecimal values."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from crtk_sim_backends.kit import Fault, FaultKind, Parameter, Session
from crtk_sim_backends.kit.modbus_line import Distortion
from crtk_sim_backends.schunk.gripper.gripper import CONTROL, STATUS, Gripper

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("refuses", "its web server refuses what is written", lasting=True),
        FaultKind(
            "http_status",
            "its web server answers with another status",
            {"code": Parameter(int, 500, minimum=300, maximum=599)},
            lasting=True,
        ),
        FaultKind(
            "nonsense", "its web server answers with something else than values", lasting=True
        ),
        FaultKind("closes", "its web server closes each connection after its answer", lasting=True),
        FaultKind(
            "echoes",
            "its web server sends each answer once more, so many seconds later",
            {"seconds": Parameter(float, 0.01, minimum=0.0, maximum=1.0)},
            lasting=True,
        ),
        FaultKind("chunked", "its web server sends its answers in chunks", lasting=True),
    )
}

LONGEST: Final = 65536


class Manners:
    """How the web server answers now."""

    kinds = KINDS

    def __init__(self) -> None:
        self.faults: dict[str, Mapping[str, Any]] = {}

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self.faults[fault.kind] = fault.parameters

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self.faults.pop(fault.kind, None)


class WebSession:
    """One client.

    Args:
        gripper: that it speaks to.
        memory: values of parameters, by instance.
        manners: of the answers.
        distortion: of these and all others.
        later: sends bytes to this session so many seconds from now.
    """

    def __init__(
        self,
        gripper: Gripper,
        memory: dict[int, bytes],
        manners: Manners,
        distortion: Distortion,
        later: Callable[[float, Session, bytes], object],
    ) -> None:
        self.ended = False
        self._gripper = gripper
        self._memory = memory
        self._manners = manners
        self._distortion = distortion
        self._later = later
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers."""
        self._rest += data
        answers = b""
        while (request := self._next()) is not None:
            if self._gripper.powered:
                answers += self._answer(*request)
        if not answers or self._distortion.strikes("unit_silent"):
            return b""
        if (seconds := self._manners.faults.get("echoes", {}).get("seconds")) is not None:
            self._later(seconds, self, answers)
        if self._distortion.strikes("doubled"):
            answers += answers
        if not self._distortion.delay:
            return answers
        self._later(self._distortion.delay, self, answers)
        return b""

    def close(self) -> None:
        """Forget an unfinished request."""
        self._rest = b""

    def _next(self) -> tuple[str, str, str] | None:
        """Take a whole request out of what has come: method, target, body."""
        head, blank, rest = self._rest.partition(b"\r\n\r\n")
        if not blank:
            self.ended = self.ended or len(self._rest) > LONGEST
            return None
        line, *headers = head.decode("latin-1").split("\r\n")
        named = {
            name.lower(): value.strip() for name, _, value in (h.partition(":") for h in headers)
        }
        size = int(named.get("content-length", "0"))
        if len(rest) < size:
            return None
        self._rest = rest[size:]
        method, target, *_ = [*line.split(), "", ""]
        return method, target, rest[:size].decode("latin-1")

    def _answer(self, method: str, target: str, body: str) -> bytes:
        faults, url = self._manners.faults, urlsplit(target)
        told: object = None
        if method == "GET" and url.path == "/adi/data.json":
            told = self._read(parse_qs(url.query))
        elif method == "GET" and url.path == "/adi/info.json":
            told = {"dataformat": 0}
        elif method == "POST" and url.path == "/adi/update.json":
            told = {"result": 1 if "refuses" in faults else self._write(parse_qs(body))}
        status = faults.get("http_status", {}).get("code", 200 if told is not None else 404)
        text = "<html>busy</html>" if "nonsense" in faults else json.dumps(told)
        return self._message(status, text.encode())

    def _message(self, status: int, body: bytes) -> bytes:
        head = f"HTTP/1.1 {status} X\r\nContent-Type: application/json\r\n"
        if "closes" in self._manners.faults:
            self.ended = True
            return f"{head}Connection: close\r\n\r\n".encode() + body
        if "chunked" in self._manners.faults:
            pieces = [body[at : at + 7] for at in range(0, len(body), 7)]
            chunks = b"".join(b"%x\r\n%b\r\n" % (len(piece), piece) for piece in (*pieces, b""))
            return f"{head}Transfer-Encoding: chunked\r\n\r\n".encode() + chunks
        return f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body

    def _read(self, query: Mapping[str, list[str]]) -> list[str]:
        try:
            instance = int(query["inst"][0], 16)
        except (KeyError, ValueError):
            return []
        if query.get("count") != ["1"]:
            return []
        values = {
            **self._memory,
            STATUS: self._gripper.report,
            CONTROL: bytes(self._gripper.written),
        }
        return [values[instance].hex().upper()] if instance in values else []

    def _write(self, form: Mapping[str, list[str]]) -> int:
        try:
            instance, value = int(form["inst"][0], 16), bytes.fromhex(form["value"][0])
        except (KeyError, ValueError):
            return 1
        if instance != CONTROL or len(value) != 16:
            return 1
        self._gripper.write(0, value)
        return 0
