"""The scenarios in which every device of the table is judged: each takes a world and the device's name.

This file is imported by the host of a world, in patched Python, so it imports no pytest.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from world.haptics import HAPTICS
from world.instruments import INSTRUMENTS
from world.pedals import PEDALS
from world.pedals import tread as tread_on
from world.subjects import SUBJECTS

from crtk_drivers.testing.world import World, far_user, instrument_user, pusher, user

HAS_ROS: Final = find_spec("rclpy") is not None
if HAS_ROS:  # imported once, for all worlds
    import crtk_drivers.client
    import crtk_drivers.client.ros_link
    import crtk_drivers.ros.serving  # noqa: F401

SCENARIOS: Final = {
    "use": tuple(SUBJECTS),
    "farewell": tuple(SUBJECTS),
    "die": tuple(SUBJECTS),
    "still": tuple(SUBJECTS),
    "far": tuple(SUBJECTS) if HAS_ROS else (),
    "watch": tuple(INSTRUMENTS),
    "push": tuple(HAPTICS),
    "tread": tuple(PEDALS),
}
"""Names of the functions below, and the devices of each."""


def use(world: World, device: str) -> None:
    """Use a device in any way, and close it."""
    user.use(world, SUBJECTS[device])


def farewell(world: World, device: str) -> None:
    """Let a fault and `close` come within milliseconds of each other."""
    user.farewell(world, SUBJECTS[device])


def die(world: World, device: str) -> None:
    """Kill a device's driver while it works."""
    user.die(world, SUBJECTS[device])


def still(world: World, device: str) -> None:
    """Let a device's simulator stand still."""
    user.still(world, SUBJECTS[device])


def far(world: World, device: str) -> None:
    """Use a device through its ROS 2 node, by clients that may die."""
    far_user.far(world, SUBJECTS[device])


def watch(world: World, device: str) -> None:
    """Read a device that measures, and set it in any way."""
    instrument_user.watch(world, INSTRUMENTS[device])


def push(world: World, device: str) -> None:
    """Stream forces to a haptic device, and close or kill its driver."""
    pusher.push(world, HAPTICS[device])


def tread(world: World, device: str) -> None:
    """Tread on a pedal, unplug it, and close its driver."""
    tread_on(world, PEDALS[device])
