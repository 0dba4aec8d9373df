"""Scenarios: one device after the other, connected, enabled, moved and closed in a world.

The host that imports this file also loads what each device needs. That takes 0.8 s of CPU, and each of its
worlds is spared it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

import crtk_drivers
from crtk_drivers import plugins
from crtk_drivers.errors import CrtkError
from crtk_drivers.testing.world.hosts.world_host import NAME

if TYPE_CHECKING:
    from crtk_drivers.testing.world import World

STAY: Final = 0.5
"""s for which a device that does not move stays connected."""


@dataclass(frozen=True)
class Visit:
    """A scenario: connect to a simulated device, enable it, move it a little, close it.

    Args:
        device: name of its plugin.
        config: for the driver.
        step: of the move of each joint, in its own unit.
        seconds: it moves to and fro for so long; at 0 it moves once.
    """

    device: str
    config: Mapping[str, Any] = field(default_factory=dict)
    step: float = 0.01
    seconds: float = 0.0

    def __call__(self, world: World) -> None:
        """Be the scenario. In bad weather the driver may raise one of its own errors."""
        try:
            self._visit(world)
        except CrtkError as error:
            if not world.wild:
                raise
            world.say(f"{type(error).__name__}: {error}")

    def _visit(self, world: World) -> None:
        with crtk_drivers.connect(self.device, sim=True, config=dict(self.config)) as device:
            world.say("connected")
            if hasattr(device, "enable"):
                device.enable()
            if "move_jp" not in device.crtk_commands:
                time.sleep(self.seconds or STAY)
                return
            end = time.monotonic() + self.seconds
            here = device.setpoint_js().position
            there = here + self.step
            while True:
                device.move_jp(there).wait()
                world.say("moved")
                here, there = there, here
                if time.monotonic() >= end:
                    return


visits: Final = SimpleNamespace(
    ati_netft=Visit("ati-netft"),
    canopen=Visit("canopen"),
    copley=Visit("copley"),
    dvrk=Visit("dvrk"),
    dynamixel=Visit("dynamixel"),
    galil=Visit("galil"),
    haply=Visit("haply"),
    inputs=Visit("inputs"),
    ndi=Visit("ndi"),
    onrobot=Visit("onrobot"),
    optoforce=Visit("optoforce"),
    raven=Visit("raven"),
    robotiq_epick=Visit("robotiq-epick"),
    robotiq_ft300=Visit("robotiq-ft300"),
    robotiq_serial=Visit("robotiq", {"link": "serial"}),
    robotiq_tcp=Visit("robotiq", {"link": "modbus"}),
    schunk=Visit("schunk"),
    schunk_fts=Visit("schunk-fts"),
    ur=Visit("ur", {"control": "native"}),
    weiss_wsg=Visit("weiss-wsg"),
)
long_visits: Final = SimpleNamespace(
    **{name: replace(visit, seconds=20.0) for name, visit in vars(visits).items()}
)
"""For figures: `bench/world_speed.py`."""
ABSENT: Final = {
    "force-dimension": "a compiler makes its simulator's library: no program of Python",
    "openhaptics": "a compiler makes its simulator's library: no program of Python",
    "ros2-control": "rclpy waits for the real system, and its simulator is a process of ROS 2",
}
"""Devices with a simulator that does not run in a world, and why."""


def load_all() -> None:
    """Import what the devices need."""
    for visit in vars(visits).values():
        plugins.device(visit.device)
        plugins.simulator(visit.device)


if __name__ == NAME:
    load_all()
