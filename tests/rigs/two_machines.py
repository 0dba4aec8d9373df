"""Two machines as two network namespaces with a cable between them, each with a host name of its own.

Nothing has a name outside: a namespace lasts as long as a process in it, and those end with this one, however
that ends. The addresses, the cable and all traffic are within; the machine's own network is not touched.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import pytest

from crtk_drivers.config.variables import RANGE, merged
from crtk_drivers.labs.reports import PULSE_FD, REPORT_FD
from rigs.lab_up import Up
from rigs.programs import COMMAND
from rigs.system_clock import shifted
from rigs.waiting import LONG

CABLE: Final = "cable0"

_DIES_WITH_US: Final = ("setpriv", "--pdeathsig", "KILL")
_IS_UP: Final = "is up"


class Machine:
    """One of them. `up`, `device` and `run` start programs on it.

    Args:
        name: host name.
        number: last part of its address.
        holder: pid of a process in its namespaces.
    """

    def __init__(self, name: str, number: int, holder: int) -> None:
        self.name = name
        self.address = f"10.77.0.{number}"
        self.holder = holder

    def command(self, *words: str) -> list[str]:
        """Return a command as it runs there."""
        enter = ("nsenter", "--target", str(self.holder), "--net", "--uts", "--")
        return [*_DIES_WITH_US, *enter, *words]

    def python(self, *words: str) -> list[str]:
        """Return the command of a module of Python, and its arguments."""
        return self.command(sys.executable, "-m", *words)

    def environment(self, shift: float = 0.0, **variables: str) -> dict[str, str]:
        """Return the environment of its programs: they meet others in the network.

        Args:
            shift: seconds that its clock is ahead.
            variables: over the others.
        """
        shell = {name: value for name, value in os.environ.items() if name not in _OURS}
        return shifted(shift, merged(shell, {RANGE: "SUBNET", **variables}))

    @contextmanager
    def device(self, namespace: str, shift: float = 0.0, **variables: str) -> Iterator[None]:
        """Run a loopback device there, and wait until it is on ROS; see `environment`."""
        process = subprocess.Popen(
            self.python(COMMAND, "loopback", "--ns", namespace),
            env=self.environment(shift, **variables),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        with process:
            try:
                Up(process).until(f"{namespace}  DISABLED")
                yield
            finally:
                process.kill()

    @contextmanager
    def up(self, lab: Path) -> Iterator[Up]:
        """Run `crtk-driver up` there."""
        words = ("up", str(lab), "--logs", str(lab.parent))
        process = subprocess.Popen(
            self.python(COMMAND, *words), env=self.environment(), stderr=subprocess.PIPE, text=True
        )
        with process:
            try:
                yield Up(process)
            finally:
                process.kill()

    def run(self, *words: str, **variables: str) -> tuple[int, str]:
        """Run `crtk-driver` there; return its exit code, and all that it wrote. See `environment`."""
        done = subprocess.run(
            self.python(COMMAND, *words),
            env=self.environment(0.0, COLUMNS="200", **variables),
            text=True,
            timeout=LONG,
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        return done.returncode, done.stdout

    def set_link(self, *, up: bool) -> None:
        """Plug its end of the cable in, or out. The route of multicast goes with it."""
        _ip(self, "link", "set", CABLE, "up" if up else "down")
        if up:
            _ip(self, "route", "replace", "224.0.0.0/4", "dev", CABLE)


_OURS: Final = (REPORT_FD, PULSE_FD)


@contextmanager
def two_machines(
    first: str = "control", second: str = "tracking"
) -> Iterator[tuple[Machine, Machine]]:
    """Make two machines with a cable between them; skip the test where this system does not let us."""
    with ExitStack() as stack:
        one, other = (
            Machine(name, number, stack.enter_context(_holder(name)))
            for number, name in enumerate((first, second), 1)
        )
        ends = ("type", "veth", "peer", "name", CABLE, "netns", str(other.holder))
        _ip(one, "link", "add", "name", CABLE, *ends)
        for machine in (one, other):
            _ip(machine, "address", "add", f"{machine.address}/24", "dev", CABLE)
            machine.set_link(up=True)
        yield one, other


@contextmanager
def _holder(name: str) -> Iterator[int]:
    """Keep the namespaces of a machine for as long as this process, or until the end."""
    script = f"hostname {name} && ip link set lo up && echo {_IS_UP} && exec cat"
    command = [*_DIES_WITH_US, "unshare", "--net", "--uts", "sh", "-c", script]
    try:
        process = subprocess.Popen(
            command,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
    except FileNotFoundError as error:
        pytest.skip(f"no namespaces of the network can be made: {error}")
    with process:
        try:
            assert process.stdout is not None
            if (said := process.stdout.readline().strip()) != _IS_UP:
                pytest.skip(f"no namespaces of the network can be made: {said}")
            yield process.pid
        finally:
            process.kill()


def _ip(machine: Machine, *words: str) -> None:
    """Run ``ip`` in the network of a machine, with process ids as they are outside."""
    command: Sequence[str] = machine.command("ip", *words)
    done = subprocess.run(command, text=True, capture_output=True, check=False)
    if done.returncode:
        pytest.skip(f"`ip {' '.join(words)}` is refused: {done.stderr.strip()}")
