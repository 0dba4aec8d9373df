"""A leader's gripper leads a follower's jaw, over ROS 2."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import pytest

from crtk_drivers.client.teleop import Teleoperation, reached_sides
from crtk_drivers.device import (
    Capabilities,
    Device,
    JointLimits,
    Mode,
    Setpoint,
    StopPolicy,
)
from crtk_drivers.motion.teleop import Heard, Phase, TeleopSettings
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import JointState, Sample, Stamp, vector
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import serve
from rigs.waiting import LONG, eventually

GRIPPER = {
    "follower": "jaw",
    "leader_closed": 0.0,
    "leader_open": 0.5,
    "follower_closed": 0.0,
    "follower_open": 1.0,
    "speed": 20.0,
    "timeout": LONG,
}


CAPABILITIES = Capabilities(
    joints=("opening",),
    limits=(JointLimits(-1.0, 2.0, 50.0, 1000.0, 10_000.0, 0.0),),
    modes=frozenset({Mode.JOINT_POSITION}),
    rate=100.0,
    stop=StopPolicy(0.0, "stands"),
)


class Finger(Device):
    """One joint that is where it is put."""

    def __init__(self, address: str) -> None:
        self._address = address
        self.at = 0.0

    @property
    def address(self) -> str:
        return self._address

    @property
    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def open(self, deadline: float) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, deadline: float) -> Sample:
        there = JointState(vector((self.at,)), vector((0.0,)), name=("opening",))
        return Sample(Stamp.now(), {"measured_js": there})

    def write(self, setpoint: Setpoint) -> None:
        self.at = float(setpoint.values[0])

    def stop(self) -> None:
        pass


class Hand(LoopbackDevice):
    """A gantry with a gripper."""

    part = "gripper"

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.finger = Finger(f"{self.address} {self.part}")

    @property
    def children(self) -> Mapping[str, Device]:
        return {self.part: self.finger}

    @property
    def followers(self) -> frozenset[str]:
        return frozenset(self.children)


class Arm(Hand):
    """A gantry with a jaw."""

    part = "jaw"


class Foot:
    """A pedal in this process."""

    doubt = ""

    def __init__(self) -> None:
        self.pressed = False

    def read(self) -> Heard[bool]:
        return Heard(self.pressed, float("inf"))


HAND, ARM = (
    DevicePlugin(kind.__name__.lower(), "A gantry with one joint more.", LoopbackConfig, kind)
    for kind in (Hand, Arm)
)


@pytest.mark.ros
@pytest.mark.timeout(120)
def test_the_jaw_is_led_once_the_hand_has_been_where_it_is() -> None:
    foot = Foot()
    given = {"leader": "/jaw_hand", "follower": "/jaw_arm", "engage": {"key": "x"}}
    with (
        serve(LoopbackConfig(address="hand"), "/jaw_hand", [], plugin=HAND) as (hand, _),
        serve(LoopbackConfig(address="arm"), "/jaw_arm", [], plugin=ARM) as (arm, _),
        reached_sides("/jaw_hand", "/jaw_arm", LONG) as (_, leader, follower),
    ):
        for device in (leader, follower):
            device.enable()
        eventually(lambda: arm.children["jaw"].status.state == "ENABLED", "the jaw is enabled")
        fingers, jaw = hand.children["gripper"].device, arm.children["jaw"].device
        settings = TeleopSettings(**given, gripper=GRIPPER).model_copy(update={"timeout": LONG})
        loop = Teleoperation(settings, leader, follower, {"engage": foot})
        stop = threading.Event()
        thread = threading.Thread(target=loop.run, args=(stop, lambda coupled: None), name="teleop")
        thread.start()
        try:
            eventually(lambda: loop.coupled.phase is Phase.RELEASED, f"released: {loop.coupled}")
            fingers.at = 0.5  # the hand is open, the jaw is not
            eventually(lambda: leader.gripper.measured_js(age=0).position[0] == 0.5, "open")
            foot.pressed = True
            eventually(lambda: loop.coupled.phase is Phase.FOLLOWING, f"following: {loop.coupled}")
            steps = loop.steps
            eventually(lambda: loop.steps > steps + 20, "a while")
            assert jaw.at == 0.0
            fingers.at = 0.0
            eventually(lambda: loop.coupled.jaw.is_led, "it is where the jaw is")
            fingers.at = 0.25
            eventually(lambda: jaw.at == pytest.approx(0.5, abs=1e-6), "half open")
            foot.pressed = False
            eventually(lambda: loop.coupled.phase is Phase.RELEASED, "let go")
            fingers.at = 0.0
            eventually(lambda: leader.gripper.measured_js(age=0).position[0] == 0.0, "squeezed")
            assert jaw.at == pytest.approx(0.5, abs=1e-6)
        finally:
            stop.set()
            thread.join()
            problem = loop.end()
            loop.close()
        assert problem == ""
