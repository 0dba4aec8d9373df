"""A simulated linear stage that speaks the real one's protocol. It shares no code with the driver."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class SimConfig:
    """The options of ``crtk-driver sim one_axis``."""

    host: str = field(default="127.0.0.1", metadata={"help": "Loopback address to listen on."})
    port: int = field(default=0, metadata={"help": "TCP port; 0 takes a free one."})
    travel: float = field(default=0.5, metadata={"help": "Length of the stage, in m."})


class RunningSim:
    """The simulator's process, and the line to it."""

    def __init__(self, config: SimConfig) -> None:
        self.host = config.host
        self.ttys: Mapping[str, str] = {}
        self.paths: Mapping[str, str] = {}
        self.hints: tuple[str, ...] = ()
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                __name__,
                f"--host={config.host}",
                f"--port={config.port}",
                f"--travel={config.travel}",
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            self.ports: Mapping[str, int] = {"stage": self._answer()["port"]}
        except BaseException:
            self.stop()
            raise

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def control(self) -> RunningSim:
        """By which faults are injected."""
        return self

    @property
    def running(self) -> bool:
        """Whether its process lives."""
        return self._process.poll() is None

    def inject(self, kind: str, **parameters: Any) -> None:
        """Begin a fault: ``disconnect``, ``silence`` or ``overload``."""
        self._ask(do="inject", kind=kind, **parameters)

    def clear(self, kind: str | None = None) -> None:
        """End a fault, or all of them."""
        self._ask(do="clear", kind=kind)

    def status(self) -> dict[str, Any]:
        """Return position in m, whether it is powered, and the faults."""
        return self._ask(do="status")

    def stop(self, timeout: float = 2.0) -> int:
        """End the process and return its exit code."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()
        finally:
            self._process.stdout.close()

    def _ask(self, **request: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        answer = self._answer()
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the simulator ended; its last words are on standard error")
        answer: dict[str, Any] = json.loads(line)
        return answer


class OneAxisSim:
    """The entry point of the simulator."""

    name = "one_axis"
    summary = "a linear stage with a line protocol over TCP (example of a plugin)"
    Config = SimConfig

    def spawn(self, config: SimConfig) -> RunningSim:
        """Start it and return when it can be connected to.

        Raises:
            RuntimeError: it could not be started.
        """
        return RunningSim(config)


SIM = OneAxisSim()
