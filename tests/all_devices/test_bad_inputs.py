"""The twenty bad inputs on every driver at its simulator, and on the devices that need none."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from bench.reliability.rig import Rig
from bench.reliability.rigs import RIGS
from crtk_drivers.errors import CrtkError
from crtk_drivers.state import OperatingState
from rigs.bad_inputs import BAD_INPUTS, Bench, NotApplicable
from rigs.gripper_rigs import OnRobotRig, SchunkRig, WsgRig

NOT_ASKED = {"force-dimension", "openhaptics"}
"""They take poses and have no joints, which these inputs ask for; haply stands for their forces."""

ASKED: Mapping[str, type[Rig]] = {
    **{name: rig for name, rig in RIGS.items() if name not in NOT_ASKED},
    **{rig.name: rig for rig in (OnRobotRig, SchunkRig, WsgRig)},
}

DEVICES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    **{name: (name, {}) for name in ASKED},
    # A client in a hurry keeps the I/O thread from its turn, and what the servos do then is not asked here.
    "dynamixel": ("dynamixel", {"watchdog": 2.5}),
    "copley": ("copley", {"reply_timeout": 1.0}),
    "loopback": ("loopback", {"base": {"position": (0.1, 0.2, 0.3)}, "needs_homing": True}),
    "virtual": ("virtual", {"base": {"position": (0.1, 0.2, 0.3)}}),
    "haptic": ("virtual", {"model": "haptic"}),
}
"""A rig, and configuration with which it offers more, by name."""

SWITCH_INTERVAL = 0.0005
"""Seconds, as in the driver's own process: a client in a hurry must not stop its I/O thread."""

STALL_LIMIT = 20.0
"""Seconds. On a busy machine the I/O thread and this test share one Python's global lock, and few cores."""

_NOT_THE_DEVICES = {"I18"}
_OF_POSES = {"I6", "I7", "I10"}
_OF_JOINTS = {"I3", "I4", "I5", "I8", "I9", "I14", "I15", "I16", "I20"}
_OF_MOTION = set(BAD_INPUTS) - {"I11", "I13", "I17", "I19"}
NOT_THERE: Mapping[str, set[str]] = {
    "canopen": _NOT_THE_DEVICES | _OF_POSES,
    "copley": _NOT_THE_DEVICES | _OF_POSES,
    "galil": _NOT_THE_DEVICES | _OF_POSES,
    "dvrk": _NOT_THE_DEVICES | _OF_MOTION,
    "dvrk-driven": _NOT_THE_DEVICES | _OF_POSES | {"I5", "I9", "I14", "I15", "I16", "I20"},
    "haply": _NOT_THE_DEVICES | _OF_POSES - {"I10"} | _OF_JOINTS,
    "robotiq": _NOT_THE_DEVICES | _OF_POSES,
    "robotiq-urcap": _NOT_THE_DEVICES | _OF_POSES,
    "onrobot": _NOT_THE_DEVICES | _OF_POSES,
    "schunk": _NOT_THE_DEVICES | _OF_POSES,
    "ros2-control": _NOT_THE_DEVICES | _OF_POSES,
    "weiss-wsg": _NOT_THE_DEVICES | _OF_POSES,
    "ati-netft": _NOT_THE_DEVICES | _OF_MOTION,
    "robotiq-ft300": _NOT_THE_DEVICES | _OF_MOTION,
    "ndi": _NOT_THE_DEVICES | _OF_MOTION,
    "optoforce": _NOT_THE_DEVICES | _OF_MOTION,
    "raven": _NOT_THE_DEVICES | _OF_MOTION,
    "inputs": _NOT_THE_DEVICES | _OF_MOTION,
}
"""What says that it does not apply; nothing else may."""


class Running:
    """The rig of one driver, and another one after a test has failed."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._rig: Rig | None = None

    @property
    def rig(self) -> Rig:
        """Ready."""
        if self._rig is None:
            driver, added = DEVICES[self.name]
            kind = ASKED[driver]
            limits = {**kind.values.get("limits", {}), "max_command_age": 1.0}
            values = {**kind.values, **added, "limits": limits}
            patient = {"values": values, "stall_limit": STALL_LIMIT}
            self._rig = type(kind.__name__, (kind,), patient)().__enter__()
            self._rig.ready()
            if self._rig.engine.capabilities.needs_homing:
                self._rig.arm.home()
        return self._rig

    def drop(self) -> None:
        """End it."""
        rig, self._rig = self._rig, None
        if rig is not None:
            rig.__exit__(None, None, None)


AT_NIGHT = {"dvrk-driven", "optoforce", "raven", "inputs"}
"""Devices whose kin are asked by day."""


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=pytest.mark.slow) if name in AT_NIGHT else name for name in DEVICES
    ],
)
def running(request: pytest.FixtureRequest) -> Iterator[Running]:
    running, interval = Running(request.param), sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    yield running
    running.drop()
    sys.setswitchinterval(interval)


@pytest.mark.sweep(4)
@pytest.mark.parametrize("number", BAD_INPUTS)
def test_bad_input(running: Running, number: str, tmp_path: Path) -> None:
    rig = running.rig
    bench = Bench(rig.driver, rig.arm, tmp_path)
    try:
        if number in NOT_THERE.get(running.name, _NOT_THE_DEVICES):
            with pytest.raises(NotApplicable) as reason:
                BAD_INPUTS[number](bench)
            pytest.skip(str(reason.value))
        assert BAD_INPUTS[number](bench) > 0
        assert rig.status.state is OperatingState.ENABLED
        assert not rig.status.is_busy
    except (AssertionError, CrtkError):
        running.drop()
        raise
