"""A simulated dVRK controller in its own process, its driver in this one, and a bare client of boards."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from crtk_driver_dvrk import PLUGIN, driven
from crtk_driver_dvrk.config import DvrkConfig
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_driver_dvrk.registers import AxisState, BoardState
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.dvrk import RunningSim
from rigs.waiting import LONG, eventually

PATIENT = {"sample_timeout": 1.5, "open_timeout": 10.0, "rate": 200.0, "reply_timeout": 0.01}
"""With which a busy machine is no fault."""

DRIVEN = {
    "drive": True,
    "watchdog": 0.3,
    "feedback_timeout": 2.0,
    "sample_timeout": 1.9,
    "reply_timeout": 0.06,
    "angular_velocity": 8.0,
    "linear_velocity": 2.0,
}
"""The same of an arm that is driven."""

COASTS = 5.0
"""Seconds, in place of one, in which a stop must have been read back."""

UNHURRIED = {"patience": 40.0, "power_delay": 0.02}
"""Of its simulator: a watchdog that nobody feeds expires after 12 s, and none on a busy machine."""

PSM: dict[str, Any] = json.loads(Path(TYPICAL["io"]).read_text())
"""The simulated arm's file of inputs and outputs."""

NODES = (0, 0, 0, 0, 1, 1, 1)
AXES = (0, 1, 2, 3, 0, 1, 2)
"""Node and axis of each of its actuators."""

ZERO = [round(each["drive"]["current_to_bits"]["offset"]) for each in PSM["robots"][0]["actuators"]]
"""What no current is for the converter of each."""


def configuration(sim: RunningSim, **values: Any) -> DvrkConfig:
    """Return the driver's configuration for a running simulator."""
    config = load(DvrkConfig, from_values({**PATIENT, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, DvrkConfig)
    return pointed


@contextmanager
def arm_at(sim: RunningSim, **values: Any) -> Iterator[LocalDevice]:
    """The driver at a simulator, connected."""
    with patch.object(driven, "_COASTS", COASTS):
        arm = LocalDevice(Session(PLUGIN, configuration(sim, **values)))
    try:
        arm._session.start()
        eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
        yield arm
    finally:
        arm.close()


@contextmanager
def driven_at(sim: RunningSim, **values: Any) -> Iterator[LocalDevice]:
    """The driver at a simulator, connected, driving, its encoders set by potentiometers."""
    with arm_at(sim, **{**DRIVEN, **values}) as arm:
        arm.set_encoders(timeout=LONG)
        yield arm


def push(arm: LocalDevice, efforts: Sequence[float]) -> None:
    """Send one setpoint of a stream; it is refused where nothing was measured for a moment."""
    try:
        arm.servo_jf(efforts)
    except CommandRefused as refusal:
        if refusal.reason is not Reason.NOT_MEASURED:
            raise


def set_encoders(sim: RunningSim) -> None:
    """Let encoders count from what potentiometers say, as after dVRK's homing."""
    with driven_at(sim):
        return


def board_state(number: int, axis: int = 0, **changes: Any) -> BoardState:
    """A board whose amplifiers are on, at rest and without current, but for changes of it or of one axis."""
    at_rest = AxisState(0x8000, 0x8000, 0, 0.0, False, False, True, False, False, False, 0x8000)
    axes = [at_rest] * 4
    axes[axis] = at_rest._replace(**{n: v for n, v in changes.items() if n in AxisState._fields})
    board = BoardState(
        elapsed=0.004, board=number, channels=4, timed_out=False, power=True, voltage_good=True,
        relay=True, relay_closed=True, supply_fault=False, encoder_supply_fault=False, inputs=0,
        temperatures=(31.0, 33.0), axes=tuple(axes),
    )  # fmt: skip
    return board._replace(**{n: v for n, v in changes.items() if n in BoardState._fields})


def boards_of(sim: RunningSim) -> list[dict[str, Any]]:
    """What the simulated boards are, really."""
    found: list[dict[str, Any]] = sim.control.status()["boards"]
    return found


def is_dead(sim: RunningSim) -> bool:
    """Whether no motor of the arm has a current, an amplifier or power."""
    boards = boards_of(sim)
    commands = [boards[node]["command"][axis] for node, axis in zip(NODES, AXES, strict=True)]
    on = any(is_on for board in boards for is_on in board["on"])
    return commands == ZERO and not on and not any(board["power"] for board in boards)


def refused(sim: RunningSim, words: str, **values: Any) -> None:
    """The driver says so, and does not get connected."""
    arm = LocalDevice(Session(PLUGIN, configuration(sim, **values)))
    try:
        arm._session.start()
        eventually(lambda: words in arm.operating_state().detail, words)
        assert not arm.engine.connected
    finally:
        arm.close()


def notes(arm: LocalDevice) -> str:
    """All that is told of an arm in health, as one text."""
    return "\n".join(f"{note.key}: {note.text}" for note in arm.health().notes)


@contextmanager
def datagrams(sim: RunningSim) -> Iterator[socket.socket]:
    """A socket connected to the boards."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(10.0)
        client.connect((sim.host, sim.ports["boards"]))
        yield client
