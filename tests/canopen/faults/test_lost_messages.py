"""Exactly one message on the way to a stop is lost, doubled or late, for each kind of message: it stops."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import PERIOD, TIMEOUT, arm_of, arm_on, device_of, drives
from rigs.waiting import LONG, eventually

COUNT = 2
MOVING = 1e4

MESSAGES = {
    "SYNC": 0x080,
    "first PDO to a drive": 0x202,
    "second PDO to a drive": 0x302,
    "first PDO of a drive": 0x182,
    "second PDO of a drive": 0x282,
    "our heartbeat": 0x77F,
    "heartbeat of a drive": 0x702,
    "SDO to a drive": 0x602,
    "SDO of a drive": 0x582,
    "NMT command": 0x000,
}

HAPPENS: tuple[dict[str, Any], ...] = (
    {"effect": "lost", "number": 1},
    {"effect": "late", "number": 1, "seconds": 5 * PERIOD},
    {"effect": "lost", "number": 2},
    {"effect": "doubled", "number": 2},
)
"""What happens to one message, and which of its kind it is."""

AFTERWARDS = 6 * PERIOD
"""Seconds in which what is late has come."""

STREAMS = {"servo_jv": 0.5, "servo_jf": 3.0}


class Bench:
    """An arm that can be connected anew, on simulated drives."""

    def __init__(self, sim: RunningSim) -> None:
        self.sim = sim
        self._arm = ExitStack()
        self._connected: tuple[str, LocalDevice] | None = None

    def arm(self, on_close: str) -> LocalDevice:
        """The arm, enabled."""
        if self._connected is None or self._connected[0] != on_close:
            self.close()
            arm = self._arm.enter_context(arm_of(arm_on(self.sim, COUNT, on_close=on_close)))
            self._connected = on_close, arm
        arm = self._connected[1]
        eventually(lambda: arm.engine.transition_ended, "it is disabled")
        arm.enable(LONG)
        return arm

    def close(self) -> None:
        self._connected = None
        self._arm.close()

    def drives(self) -> list[dict[str, Any]]:
        told = self.sim.control.status()["drives"]
        return [told[str(node)]["axes"][0] for node in sorted(map(int, told))]

    def revolutions(self) -> list[float]:
        return [drive["revolutions"] for drive in self.drives()]

    def moves(self, arm: LocalDevice, command: str) -> None:
        """Begin a motion away from the ends of the range."""
        away = -1.0 if arm.measured_js().position[0] > 0.0 else 1.0

        def runs() -> bool:
            with suppress(CommandRefused):
                if command == "move_jp":
                    arm.move_jp([2.0 * away] * COUNT)
                else:
                    getattr(arm, command)([away * STREAMS[command]] * COUNT)
            return min(abs(drive["velocity"]) for drive in self.drives()) > MOVING

        eventually(runs, "it moves")

    def stands(self) -> bool:
        return all(abs(drive["velocity"]) < 1.0 for drive in self.drives())

    def has_stopped(self, arm: LocalDevice) -> bool:
        """Whether nothing waits to be followed, a stop has been read back, and all stand, in this order."""
        return arm.engine.is_at_rest and device_of(arm).has_stopped and self.stands()


@contextmanager
def one_message(sim: RunningSim, number: int, happens: dict[str, Any]) -> Iterator[None]:
    """Have something happen to exactly one message with this identifier."""
    sim.control.inject("message", id=number, **happens)
    try:
        yield
    finally:
        sim.control.clear("message")


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with drives(COUNT) as sim:
        bench = Bench(sim)
        yield bench
        bench.close()


def hold(arm: LocalDevice) -> None:
    with suppress(CommandRefused):  # where what happened is a fault already
        arm.hold()


WAYS: dict[str, tuple[str, Callable[[LocalDevice], None]]] = {
    "hold in a move": ("move_jp", hold),
    "hold in velocities": ("servo_jv", hold),
    "hold in efforts": ("servo_jf", hold),
    "the stream ends": ("servo_jv", lambda arm: None),
    "disable": ("servo_jv", lambda arm: arm.state_command("disable", 0.0)),
}


@pytest.mark.sweep(8)
@pytest.mark.parametrize("message", MESSAGES)
@pytest.mark.parametrize("way", WAYS)
def test_one_message_on_the_way_to_a_stop_does_not_keep_it(
    bench: Bench, way: str, message: str
) -> None:
    command, stop = WAYS[way]
    for happens in HAPPENS:
        arm = bench.arm("power_off")
        bench.moves(arm, command)
        with one_message(bench.sim, MESSAGES[message], happens):
            stop(arm)
            eventually(lambda arm=arm: bench.has_stopped(arm), f"{happens}")  # type: ignore[misc]
        before = bench.revolutions()
        time.sleep(AFTERWARDS)
        np.testing.assert_allclose(bench.revolutions(), before, atol=0.1, err_msg=str(happens))


@pytest.mark.sweep(16)
@pytest.mark.parametrize("message", MESSAGES)
@pytest.mark.parametrize("on_close", ["hold", "power_off"])
def test_one_message_on_the_way_of_close_does_not_keep_the_joints_from_a_stop(
    bench: Bench, on_close: str, message: str
) -> None:
    for happens in HAPPENS[:2]:
        arm = bench.arm(on_close)
        bench.moves(arm, "servo_jv")
        with one_message(bench.sim, MESSAGES[message], happens):
            bench.close()
            eventually(bench.stands, f"{happens}")
        before = bench.revolutions()
        time.sleep(TIMEOUT + 2 * AFTERWARDS)  # longer than the drives wait for anything
        np.testing.assert_allclose(bench.revolutions(), before, atol=0.1, err_msg=str(happens))
        if on_close == "power_off":
            eventually(
                lambda: not any(drive["powered"] for drive in bench.drives()), "no power is left"
            )
