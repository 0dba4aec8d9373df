"""The simulated Raven: what its arms are led to, its pedal, its run levels, and what goes wrong.

After local_io.cpp and mapping.cpp of raven2; joints and their limits are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.datagrams import STREAM, STREAM_KINDS, FaultyWay
from crtk_sim_backends.page import Gauges
from crtk_sim_backends.raven.network import Network, Packet

PERIOD: Final = 0.001
ARMS: Final = ("gold", "green")
AXES: Final = {"gold": ((2, -1), (0, -1), (1, 1)), "green": ((2, -1), (0, 1), (1, -1))}
"""For each axis of an arm: which axis of the packets it is, and its sign."""
GRASP: Final = (-1000.0 * math.radians(30.0), 1000.0 * math.pi / 2.0)
"""mrad."""
E_STOP, PEDAL_UP, PEDAL_DOWN = 0, 2, 3
Quaternion = tuple[float, float, float, float]

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        *STREAM_KINDS.values(),
        FaultKind(
            "next",
            "of the packets to come so many are lost",
            {"lost": Parameter(int, 1, minimum=1)},
        ),
        FaultKind("emergency_stop", "somebody has pressed it", lasting=True),
        FaultKind("closed", "its software does not run: nobody listens at the port", lasting=True),
        FaultKind(
            "forgetful", "its number is another one", {"number": Parameter(int, 0, minimum=0)}
        ),
    )
}


class Arm:
    """One arm, in its own axes."""

    def __init__(self, name: str) -> None:
        self._axes = AXES[name]
        self.wanted = self.position = (0, 0, 0)
        """µm."""
        self.wanted_turn: Quaternion = (0.0, 0.0, 0.0, 1.0)
        self.turn = self.wanted_turn
        self.wanted_grasp = self.grasp = 0.0
        """mrad."""

    def add(self, move: tuple[int, int, int], turn: Quaternion, grasp: int) -> None:
        """Take the increments of a packet."""
        x, y, z = (sign * move[axis] for axis, sign in self._axes)
        self.wanted = (self.wanted[0] + x, self.wanted[1] + y, self.wanted[2] + z)
        a, b, c = (sign * turn[axis] for axis, sign in self._axes)
        self.wanted_turn = _product((a, b, c, turn[3]), self.wanted_turn)
        self.wanted_grasp = min(max(self.wanted_grasp - grasp, GRASP[0]), GRASP[1])

    def follow(self) -> None:
        """Go where it is wanted."""
        self.position, self.turn, self.grasp = self.wanted, self.wanted_turn, self.wanted_grasp

    def forget(self) -> None:
        """Want to be where it is."""
        self.wanted, self.wanted_turn, self.wanted_grasp = self.position, self.turn, self.grasp


class Robot:
    """Both arms.

    Args:
        timeout: s without a packet after which the pedal is up.
    """

    kinds = KINDS

    def __init__(self, timeout: float) -> None:
        self.network = Network()
        self.arms = {name: Arm(name) for name in ARMS}
        self.closed = False
        self.timeouts = 0
        self._timeout = timeout
        self._since = 0.0
        self._engaged = False
        self._stopped = False
        self._level = PEDAL_UP
        self._to_lose = self._lost = 0
        self._way = FaultyWay()

    def take(self, data: bytes) -> None:
        """Take a datagram."""
        for piece in self._way.through([data]):
            if self._to_lose:
                self._to_lose -= 1
                self._lost += 1
                continue
            packet = self.network.take(piece)
            if packet is not None:
                self._use(packet)

    def _use(self, packet: Packet) -> None:
        self._since = 0.0
        self._engaged = packet.engaged
        rows = zip(self.arms.values(), packet.moves, packet.turns, packet.grasps, strict=True)
        for arm, move, turn, grasp in rows:
            arm.add(move, turn, grasp)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._since += seconds
        if self._engaged and self._since > self._timeout:
            self._engaged = False
            self.timeouts += 1
        for arm in self.arms.values():
            if self._level == PEDAL_DOWN:
                arm.follow()
            else:
                arm.forget()
        pedal = PEDAL_DOWN if self._engaged else PEDAL_UP
        self._level = E_STOP if self._stopped else pedal

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if fault.kind in STREAM:
            self._way.begin(fault.kind, STREAM[fault.kind](given))
        elif fault.kind == "next":
            self._to_lose = given["lost"]
        elif fault.kind == "forgetful":
            self.network.number = given["number"]
        elif fault.kind == "closed":
            self.closed = True
        else:
            self._stopped = True

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._way.end(fault.kind)
        if fault.kind == "closed":
            self.closed = False
        elif fault.kind == "emergency_stop":
            self._stopped = False

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know: nothing of it ever reaches a driver."""
        return {
            "run_level": self._level,
            "engaged": self._engaged,
            "number": self.network.number,
            "timeouts": self.timeouts,
            "lost": self._lost,
            **self.network.counts,
            **{name: list(arm.position) for name, arm in self.arms.items()},
            **{f"{name}_turn": list(arm.turn) for name, arm in self.arms.items()},
            **{f"{name}_grasp": arm.grasp for name, arm in self.arms.items()},
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        return [
            {
                "title": name.capitalize(),
                "unit": "mm",
                "rate": "",
                "digits": 2,
                "gauges": [
                    {"name": axis, "low": -100.0, "high": 100.0, "value": 1e-3 * value}
                    for axis, value in zip("xyz", arm.position, strict=True)
                ],
            }
            for name, arm in self.arms.items()
        ]


def _product(first: Quaternion, second: Quaternion) -> Quaternion:
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    product = (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
    norm = math.hypot(*product)
    x, y, z, w = (value / norm for value in product)
    return x, y, z, w
