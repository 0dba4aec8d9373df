"""The devices that are judged in a world: where their simulators' truth is, and what their pages promise.

The scenarios are at the end: each device by each way of using it. This file is imported by the host of a
world, in patched Python, so it imports no pytest.
"""

from __future__ import annotations

from typing import Any, Final

from crtk_drivers.testing.world.subject import Subject


def _robotiq(server: Any) -> list[float]:
    gripper = server._device._device
    low, high = gripper.band
    return [gripper.model.stroke * (high - gripper.position) / (high - low)]


def _ur(server: Any) -> list[float]:
    return list(server.controller.plant.arm.actual_q)


def _dynamixel(server: Any) -> list[float]:
    return [servo.drive.angle for servo in server._servos[:6]]  # the seventh is that of a gripper


SUBJECTS: Final = {
    "robotiq": Subject(
        device="robotiq",
        config={"link": "modbus"},
        truth=_robotiq,
        still=0.004,
        arrival=0.004,
        error=0.001,
        step=0.03,
        velocity=0.03,
    ),
    "ur": Subject(
        device="ur",
        config={"control": "native"},
        truth=_ur,
        still=0.03,
        arrival=0.01,
        error=0.01,
        early=0.13,
        late=0.06,
        step=0.15,
        velocity=0.3,
    ),
    "dynamixel": Subject(
        device="dynamixel",
        truth=_dynamixel,
        still=0.15,
        arrival=0.05,
        error=0.01,
        early=0.03,
        step=0.15,
        velocity=0.3,
    ),
}
