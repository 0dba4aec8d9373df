"""The simulator's process: TCP on one side, commands of the test on standard input on the other.

    python -m crtk_sim_one_axis --host 127.0.0.1 --port 0

It prints ``{"port": 40123}`` when it can be connected to. Each line of standard input is one JSON object,
``{"do": "inject", "kind": "disconnect"}``, and is answered by one. It ends when standard input does.
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import socket
import sys
import time
from typing import Any

from crtk_sim_one_axis.stage import Stage

PERIOD = 0.01
FAULTS = ("disconnect", "silence", "overload")


class Server:
    """One stage, one host at a time."""

    def __init__(self, host: str, port: int, travel: float) -> None:
        self.stage = Stage(travel)
        self.faults: set[str] = set()
        self._selector = selectors.DefaultSelector()
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(sys.stdin, selectors.EVENT_READ, self._obey_test)
        self._host: socket.socket | None = None
        self._rest = b""
        self._stopped = False

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    def run(self) -> None:
        """Serve until standard input ends."""
        due = time.monotonic()
        while not self._stopped:
            due = max(due + PERIOD, time.monotonic() - PERIOD)
            while (wait := due - time.monotonic()) > 0.0:
                for key, _ in self._selector.select(wait):
                    key.data()
            self.stage.fault = "motor overload" if "overload" in self.faults else ""
            self.stage.advance(time.monotonic(), PERIOD)
            if "silence" not in self.faults:
                self._send(self.stage.report())
        self._drop_host()
        self._listener.close()
        self._selector.close()

    def _accept(self) -> None:
        host, _ = self._listener.accept()
        if self._host is not None or "disconnect" in self.faults:
            host.close()
            return
        host.setblocking(False)
        self._host, self._rest = host, b""
        self._selector.register(host, selectors.EVENT_READ, self._receive)

    def _receive(self) -> None:
        assert self._host is not None
        try:
            data = self._host.recv(4096)
        except OSError:
            data = b""
        if not data:
            self._drop_host()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self.stage.obey(line.decode("ascii", "replace"), time.monotonic())

    def _send(self, line: bytes) -> None:
        if self._host is None:
            return
        try:
            self._host.send(line)
        except OSError:
            self._drop_host()

    def _drop_host(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            self._selector.unregister(host)
            host.close()

    def _obey_test(self) -> None:
        line = sys.stdin.readline()
        if not line:
            self._stopped = True
            return
        print(json.dumps(self._answer(json.loads(line))), flush=True)

    def _answer(self, request: dict[str, Any]) -> dict[str, Any]:
        kind = request.get("kind")
        if kind is not None and kind not in FAULTS:
            return {"error": f"no fault {kind!r}; there are {', '.join(FAULTS)}"}
        if request["do"] == "inject":
            self.faults.add(str(kind))
        elif request["do"] == "clear":
            self.faults -= {kind} if kind else set(FAULTS)
        if "disconnect" in self.faults:
            self._drop_host()
        stage = self.stage
        return {"position": stage.position, "powered": stage.powered, "faults": [*self.faults]}


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(prog="python -m crtk_sim_one_axis", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=7890)
    parser.add_argument("--travel", type=float, default=0.5)
    options = parser.parse_args()
    try:
        server = Server(options.host, options.port, options.travel)
    except OSError as error:
        sys.exit(f"cannot listen on {options.host}:{options.port}: {os.strerror(error.errno or 0)}")
    print(json.dumps({"port": server.port}), flush=True)
    server.run()


if __name__ == "__main__":
    main()
