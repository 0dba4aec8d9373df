"""The program that Universal Robots' ROS driver runs on a robot, unmodified, on the simulator.

Its code is not part of this project. `UR_CLIENT_LIBRARY` names a checkout of
Universal_Robots_Client_Library; its ``resources/external_control.urscript`` is filled in as the
library does it, and this file stands for the library at the other end of the three sockets.
"""

from __future__ import annotations

import os
import re
import socket
import struct
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import PrimaryClient, RtdeClient
from rigs.waiting import LONG, eventually

FOLDER = Path(os.environ.get("UR_CLIENT_LIBRARY", ""))
pytestmark = pytest.mark.skipif(
    Path() == FOLDER, reason="UR_CLIENT_LIBRARY does not name the sources of UR's client library"
)

HOST = "127.0.0.1"
SCALE = 1_000_000  # of all values but times
MILLI = 1000

# Names and numbers are those of the program.
STOPPED, IDLE, SERVOJ, SPEEDJ, TRAJECTORY, SPEEDL, POSE = -2, 0, 1, 2, 3, 4, 5
MOVEJ, MOVEL, SPLINE = 0, 1, 51
SUCCESS, CANCELED = 0, 1
SET_PAYLOAD = 1

OUTPUTS = "actual_q,actual_TCP_pose,payload,runtime_state"
COMPARE: dict[str, Callable[[tuple[int, ...], tuple[int, ...]], bool]] = {
    "<": lambda a, b: a < b,
    ">=": lambda a, b: a >= b,
}


def rendered(version: tuple[int, ...], values: dict[str, str]) -> str:
    """The program for a software version: conditions by line, values in double braces."""
    lines: list[str] = []
    branches: list[tuple[bool, bool]] = []  # taken now, taken before or now
    for line in (FOLDER / "resources/external_control.urscript").read_text().splitlines():
        statement = re.fullmatch(r"\s*\{% (if|elif|else|endif) ?(.*) %\}", line)
        if statement is None:
            if all(taken for taken, _ in branches):
                lines.append(line)
            continue
        word, condition = statement.groups()
        before = branches.pop()[1] if word != "if" else False
        if word == "endif":
            continue
        holds = not before
        if condition:
            operator, number = re.fullmatch(
                r"ROBOT_SOFTWARE_VERSION (\S+) v([\d.]+)", condition
            ).groups()  # type: ignore[union-attr]
            holds &= COMPARE[operator](version, tuple(map(int, number.split("."))))
        branches.append((holds, before or holds))
    body = re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], "\n".join(lines))
    return f"def external_control():\n{body}\nend\n"


class Peer:
    """The other end of the program: what the library is for a robot."""

    def __init__(self, host: str, version: tuple[int, ...]) -> None:
        names = ("TRAJECTORY_SERVER", "SCRIPT_COMMAND_SERVER", "SERVER")
        listeners = [socket.create_server((HOST, 0)) for _ in names]
        ports = [str(listener.getsockname()[1]) for listener in listeners]
        values = {f"{name}_PORT_REPLACE": port for name, port in zip(names, ports, strict=True)}
        values |= {
            "BEGIN_REPLACE": "",
            "JOINT_STATE_REPLACE": str(SCALE),
            "TIME_REPLACE": str(MILLI),
            "SERVO_J_REPLACE": "lookahead_time=0.03, gain=2000",
            "SERVER_IP_REPLACE": HOST,
        }
        with PrimaryClient(host) as primary:
            primary.send(rendered(version, values).encode())
            connections = []
            for listener in listeners:
                with listener:
                    listener.settimeout(LONG)
                    connections.append(listener.accept()[0])
        self.trajectory, self.script_command, self.reverse = connections
        self.connections = connections
        self.rtde = RtdeClient(host)
        assert self.rtde.setup_outputs(OUTPUTS, 60)[0] == 1
        assert self.rtde.start()

    def command(
        self,
        mode: int,
        values: Sequence[float] = (0,) * 6,
        timeout: float = 5.0,
        scale: int = SCALE,
    ) -> None:
        """Send a message on the reverse socket; the program stops when no next one comes."""
        numbers = (int(timeout * 1000), *(round(value * scale) for value in values), mode)
        self.reverse.sendall(struct.pack(">8i", *numbers))

    def state(self) -> tuple[list[float], list[float], float, int]:
        """Joints, tool pose, payload and run-time state, at the next package."""
        values = self.rtde.data()
        return values[:6], values[6:12], values[12], values[13]

    def until(
        self,
        condition: Callable[[], bool],
        mode: int,
        values: Callable[[], Sequence[float]] = lambda: (0,) * 6,
    ) -> None:
        """Repeat a command, once for each package of the controller, until something is so."""
        end = time.monotonic() + LONG
        while not condition():
            assert time.monotonic() < end, f"not in mode {mode}"
            self.command(mode, values())

    def at_rest(self) -> list[float]:
        """Command nothing until the arm is at rest, and tell where."""
        last: list[float] = []

        def same() -> bool:
            before, last[:] = list(last), self.state()[0]
            return before == pytest.approx(last, abs=1e-6)

        self.until(same, IDLE)
        return last

    def run(self, *points: Sequence[int], cancel: bool = False) -> int:
        """Send a trajectory, and wait for its result."""
        self.command(TRAJECTORY, (1, len(points), 0, 0, 0, 0), scale=1)
        for point in points:
            self.trajectory.sendall(struct.pack(">21i", *point))
        if cancel:
            start = self.state()[0]
            self.until(lambda: self.state()[0] != pytest.approx(start, abs=0.01), TRAJECTORY)
            self.command(TRAJECTORY, (-1, 0, 0, 0, 0, 0), scale=1)
        self.trajectory.setblocking(False)
        answer = b""

        def answered() -> bool:
            nonlocal answer
            self.state()
            try:
                answer += self.trajectory.recv(4)
            except BlockingIOError:
                return False
            return len(answer) == 4

        self.until(answered, TRAJECTORY)
        return int.from_bytes(answer, "big")

    def close(self) -> None:
        for connection in (*self.connections, self.rtde):
            connection.close()


def point(
    kind: int, goal: Sequence[float], seconds: float = 0.0, blend: float = 0.0, spline: int = 0
) -> list[int]:
    """A point of a trajectory; a cubic spline has its type in place of the blend radius."""
    speeds = (0.0,) * 6 if kind == SPLINE else (1.0, 1.4, 0.0, 0.0, 0.0, 0.0)
    numbers = [round(value * SCALE) for value in (*goal, *(0.0,) * 6, *speeds)]
    return [*numbers, round(seconds * MILLI), spline or round(blend * MILLI), kind]


@pytest.fixture(
    params=["ur5 3.15.8", "ur5e 5.12.4", "ur3e 5.26.3", "ur10e 10.11.0"], ids=lambda p: p
)
def peer(request: pytest.FixtureRequest):  # type: ignore[no-untyped-def]
    model, version = request.param.split()
    with SIM.spawn(model=model, version=version) as sim:
        other = Peer(sim.host, tuple(map(int, version.split("."))))
        try:
            yield other
            status = sim.control.status()
        finally:
            other.close()
    assert status["statistics"]["defects"] == 0
    assert not [entry for entry in status["log"] if "Exception" in entry["text"]]


def test_streams(peer: Peer) -> None:
    start = peer.at_rest()
    goal = list(start)

    def step() -> list[float]:
        goal[0] = min(goal[0] + 0.005, start[0] + 0.1)
        return goal

    peer.until(
        lambda: peer.state()[0] == pytest.approx([start[0] + 0.1, *start[1:]], abs=1e-3),
        SERVOJ,
        step,
    )
    peer.at_rest()
    peer.until(lambda: peer.state()[0][5] < start[5] - 0.05, SPEEDJ, lambda: (0, 0, 0, 0, 0, -0.3))
    peer.at_rest()
    pose = list(peer.state()[1])
    peer.until(lambda: peer.state()[1][2] > pose[2] + 0.01, SPEEDL, lambda: (0, 0, 0.05, 0, 0, 0))
    peer.at_rest()
    pose = list(peer.state()[1])

    def sink() -> list[float]:
        pose[2] -= 0.0005
        return pose

    height = pose[2]
    peer.until(lambda: peer.state()[1][2] < height - 0.01, POSE, sink)
    peer.at_rest()


def test_trajectories(peer: Peer) -> None:
    start = peer.at_rest()
    first, second = [start[0] + 0.2, *start[1:]], [start[0] + 0.1, start[1] + 0.1, *start[2:]]
    assert peer.run(point(MOVEJ, first, blend=0.05), point(MOVEJ, second, 1.0)) == SUCCESS
    assert peer.at_rest() == pytest.approx(second, abs=1e-3)
    for kind in (1, 2):  # cubic, quintic
        goals = (first, start) if kind == 1 else (second, start)
        assert peer.run(*(point(SPLINE, goal, 0.5, spline=kind) for goal in goals)) == SUCCESS
        assert peer.at_rest() == pytest.approx(start, abs=5e-3)
    pose = list(peer.state()[1])
    pose[2] += 0.02
    assert peer.run(point(MOVEL, pose)) == SUCCESS
    peer.at_rest()
    assert peer.state()[1][2] == pytest.approx(pose[2], abs=1e-3)
    assert peer.run(point(MOVEJ, first, 9.0), point(MOVEJ, start, 9.0), cancel=True) == CANCELED
    peer.at_rest()


def test_commands_and_the_end(peer: Peer) -> None:
    peer.at_rest()
    command = [SET_PAYLOAD, *(round(value * SCALE) for value in (1.5, 0.0, 0.0, 0.1))]
    peer.script_command.sendall(struct.pack(">28i", *command, *[0] * (28 - len(command))))
    peer.until(lambda: peer.state()[2] == pytest.approx(1.5), IDLE)
    peer.command(STOPPED)
    eventually(lambda: peer.state()[3] == 1)


def test_the_program_ends_without_commands(peer: Peer) -> None:
    peer.at_rest()
    peer.command(IDLE, timeout=0.02)
    eventually(lambda: peer.state()[3] == 1)
