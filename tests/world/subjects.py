"""The devices that are judged in a world: where their simulators' truth is, and what their pages promise.

The scenarios are in `promises.py`. This file is imported by the host of a world, in patched Python, so it
imports no pytest.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Final

from crtk_drivers.testing.world.promises.subject import Subject


def _robotiq(server: Any) -> list[float]:
    gripper = server.device._device
    low, high = gripper.band
    return [gripper.model.stroke * (high - gripper.position) / (high - low)]


def _ur(server: Any) -> list[float]:
    return list(server.controller.plant.arm.actual_q)


def _dynamixel(server: Any) -> list[float]:
    return [servo.drive.angle for servo in server._servos[:6]]  # the seventh is that of a gripper


def _canopen(server: Any) -> list[float]:
    axes = [drive.axes[0] for drive in server._made.all]
    return [math.tau * (axis.motor.revolutions - axis._zero) / _GEAR for axis in axes]


def _copley(server: Any) -> list[float]:
    return [drive.axis.position / _COUNTS for drive in server.device.drives]


def _galil(server: Any) -> list[float]:
    return [axis.position / _COUNTS for axis in server.device.axes[:3]]


def _jaw(server: Any) -> list[float]:
    """Return the opening of a gripper that has nothing between its fingers."""
    device = getattr(server.device, "_device", server.device)
    return [getattr(device, "gripper", device).jaw.opening]


_GEAR: Final = 200.0
"""With it the limit switches of the simulated motors are just outside of the joints' range."""
_HOMED: Final = {
    f"joint_{node}": {
        "node": node,
        "gear": _GEAR,
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 2.0,
        "acceleration": 10.0,
        "effort": 20.0,
        "modes": ("csp", "csv", "cst"),
        "homing": {"method": 24, "speed_switch": 0.8, "speed_zero": 0.2, "acceleration": 10.0},
    }
    for node in (1, 2, 3)
}
"""Joints that go and look for a switch, over a limit switch if need be, when they are homed."""

_COUNTS: Final = 100_000 / math.tau
"""Of a joint, in one rad: as the drivers' own typical joints have it."""

_WITHOUT_GRAVITY: Final = ",".join(
    f"{number}:{model}" for number, model in enumerate(3 * ["xm540-w270"] + 4 * ["xm430-w350"], 1)
)
"""The servos of the usual arm. `disable` takes their torque away, and joints would fall for good reason."""

_arm = partial(Subject, error=0.002, step=0.15, velocity=0.3)
"""Joints in rad."""
_fingers = partial(
    Subject, arrival=0.002, error=0.001, early=0.05, lasts=5.0, step=0.03, velocity=0.03
)
"""An opening in m. A command is a whole move."""

_ALL: Final = (
    _fingers(
        device="robotiq", config={"link": "modbus"}, truth=_robotiq, arrival=0.004, early=0.006
    ),
    _arm(
        device="ur",
        config={"control": "native"},
        truth=_ur,
        error=0.01,
        early=0.13,
        late=0.06,
        without=("shut_down",),
    ),
    _arm(
        device="dynamixel",
        sim_options={"servos": _WITHOUT_GRAVITY},
        truth=_dynamixel,
        error=0.01,
        early=0.03,
    ),
    _arm(
        device="canopen",
        config={"period": 0.008, "joints": _HOMED},
        truth=_canopen,
        early=0.02,
    ),
    _arm(device="copley", truth=_copley, early=0.05),
    _arm(device="galil", truth=_galil, early=0.02),
    _fingers(device="onrobot", truth=_jaw),
    _fingers(device="weiss-wsg", truth=_jaw),
    _fingers(device="schunk", truth=_jaw, step=0.02, velocity=0.02, effort=1.0),
)
SUBJECTS: Final = {subject.device: subject for subject in _ALL}
"""All of them, by the name of the device."""
