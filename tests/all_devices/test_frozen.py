"""Hardware that freezes: what `close` says of a motion that was sent just before, and of one that has ended.

The simulator's process is stopped (SIGSTOP): what the driver sends then waits, and may be carried out later.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pytest

from bench.reliability.activities import EFFORTS, Activity
from bench.reliability.rig import PATIENCE, Rig
from bench.reliability.rigs import RIGS
from crtk_drivers.errors import StopUnconfirmed
from crtk_drivers.motion.stopping import still_speeds
from rigs.fault_rigs import SLOW
from rigs.gripper_rigs import OnRobotRig, SchunkRig, WsgRig
from rigs.waiting import eventually

ALL: Final = {**RIGS, **{rig.name: rig for rig in (OnRobotRig, SchunkRig, WsgRig)}}
GRIPPERS: Final = {
    "robotiq": 0.05,
    "robotiq-urcap": 0.05,
    "onrobot": 0.06,
    "schunk": 0.05,
    "weiss-wsg": 0.06,
}
"""Where (m) fingers are sent, and come from."""
AWAY: Final = 0.02
"""How far (m) from there they are sent next."""
FORCES: Final = {
    name: activity
    for name, rig in RIGS.items()
    for activity in rig.activities
    if activity in EFFORTS and "servo_jp" not in rig.activities
}
"""Devices that are driven by efforts alone, and by which."""
LIBRARIES: Final = frozenset({"force-dimension", "openhaptics"})
"""Those that a library reaches, not a wire to their simulator."""
ARMS: Final = tuple(
    name
    for name, rig in RIGS.items()
    if "servo_jp" in rig.activities and name not in ("virtual", "loopback", *GRIPPERS)
)
STEPS: Final = 50
STEP: Final = 0.01
"""Seconds from one setpoint of a stream to the next."""
SPARE: Final = 0.2
"""Seconds for the last setpoint to be sent."""
SAMPLES: Final = 4
"""Of joints that stand, until they are believed to."""
FADED: Final = 0.2
"""Seconds after a move in which fingers that rest seem to move still."""
MOVED: Final = tuple(dict.fromkeys((*GRIPPERS, *ARMS)))


def _marked(*names: str) -> list[Any]:
    """Return them as parameters, of which some are slow."""
    return [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in names]


def _begin(rig: Rig, far: float) -> Callable[[], Any]:
    """Return what sends a motion: a move of the first joint so far, or an effort."""
    if rig.name in FORCES:
        return Activity(FORCES[rig.name], rig.arm, rig.plan).send
    goal = np.array(rig.arm.measured_jp(age=0))
    goal[0] += far
    return lambda: rig.arm.move_jp(goal)


def _ready(rig: Rig) -> float:
    """Enable it at rest, and return how far its first joint may be sent."""
    if rig.name not in GRIPPERS:
        rig.ready()
        far = rig.plan.far / 10.0
    else:
        rig.enable()
        assert rig.arm.move_jp([GRIPPERS[rig.name]]).wait(PATIENCE)
        far = AWAY
    eventually(lambda: _stands(rig), "it stands")
    return far


def _freeze(rig: Rig) -> None:
    """Stop the process of the hardware, or the library that alone can reach it."""
    assert rig.sim is not None
    if rig.name in LIBRARIES:
        rig.inject("hang")
    else:
        rig.sim.suspend()


def _thaw(rig: Rig) -> None:
    assert rig.sim is not None
    rig.sim.resume()
    rig.sim.control.clear()


def _close_frozen(rig: Rig) -> None:
    """Close the driver while its hardware stands still and counts as lost."""
    try:
        _freeze(rig)
        _lost(rig)
        rig.driver.close()
    finally:
        _thaw(rig)


def _stands(rig: Rig) -> bool:
    """Return whether the driver has measured that all joints stand."""
    if not rig.engine.capabilities.joints:
        return True
    speeds = np.abs(np.array(rig.arm.measured_jv(age=0)))
    return bool((speeds < still_speeds(rig.engine.capabilities)).all())


def _lost(rig: Rig) -> None:
    """Wait until the frozen hardware counts as lost."""
    eventually(lambda: not rig.engine.connected, "the link is lost")


@pytest.mark.parametrize("name", _marked(*MOVED, *FORCES))
def test_close_tells_of_a_motion_nobody_saw(name: str) -> None:
    with ALL[name]() as rig:
        send = _begin(rig, _ready(rig))
        rig.disturbed.on_motion = lambda: _freeze(rig)
        try:
            send()
            _lost(rig)
            with pytest.raises(StopUnconfirmed, match="could not be read back"):
                rig.driver.close()
        finally:
            _thaw(rig)


@pytest.mark.parametrize("name", _marked(*MOVED))
def test_close_is_silent_about_a_move_that_ended(name: str) -> None:
    with ALL[name]() as rig:
        send = _begin(rig, _ready(rig))
        assert send().wait(PATIENCE)
        eventually(lambda: _stands(rig), "it stands")
        _close_frozen(rig)


@pytest.mark.parametrize("name", _marked(*ARMS))
def test_close_is_silent_about_a_stream_that_ended(name: str) -> None:
    """Joints that were measured to stand where the stream ended are not on their way."""
    with ALL[name]() as rig:
        far = _ready(rig)
        goal = np.array(rig.arm.measured_jp(age=0))
        for _ in range(STEPS):
            goal[0] += far / STEPS
            rig.arm.servo_jp(goal)
            rig.engine.wait_for(lambda: False, STEP)

        following = rig.engine.capabilities.following
        assert following is not None
        over = time.monotonic() + following.lag + SPARE

        def has_arrived() -> bool:
            """A servo that hangs below its goal counts once its lag is over."""
            here = np.array(rig.arm.measured_jp(age=0))
            is_near = bool((np.abs(here - goal) < following.arrival).all())
            is_there = is_near and rig.engine.device.has_arrived
            return _stands(rig) and (is_there or time.monotonic() > over)

        eventually(has_arrived, "it stands where it was sent")
        samples = rig.engine.health().samples
        eventually(lambda: rig.engine.health().samples > samples + SAMPLES, "it was read so")
        _close_frozen(rig)


@pytest.mark.parametrize("name", _marked(*GRIPPERS))
def test_fingers_at_rest_are_measured_to_stand_soon(name: str) -> None:
    """Their velocity is found from an opening in steps, and smoothed: it would fade for 0.3 s."""
    with ALL[name]() as rig:
        send = _begin(rig, _ready(rig))
        assert send().wait(PATIENCE)
        ended = rig.engine.health().samples
        eventually(lambda: _stands(rig), "it stands")
        taken = rig.engine.health().samples - ended  # a machine that is busy takes fewer
        assert taken < FADED * rig.engine.capabilities.rate
