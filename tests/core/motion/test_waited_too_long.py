"""Commands that lie in the mailbox while the I/O thread is held up."""

from __future__ import annotations

import pytest

from crtk_drivers.errors import Reason
from crtk_drivers.samples import JointState
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import Rig, jf, jp, jv

HELD_UP = 0.6
"""Seconds: more than a stream or the link may be silent."""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("servo_jv", jv(0.3, 0.0)),
        ("servo_jf", jf(1.0, 0.0)),
        ("servo_jp", jp(0.05, 0.0)),
        ("servo_jr", jp(0.05, 0.0)),
        ("interpolate_jp", jp(0.05, 0.0)),
    ],
)
def test_a_setpoint_is_not_begun_once_its_stream_is_over(name: str, value: JointState) -> None:
    """Its client may have gone, or have stopped sending because the device should move no more."""
    rig = Rig().enabled()
    rig.engine.submit(name, value, stamp_ns=7)
    rig.cycle(period=HELD_UP)
    assert not rig.written
    assert [(r.command, r.reason, r.stamp_ns) for r in rig.told.refusals] == [
        (name, Reason.TOO_OLD, 7)
    ]
    assert rig.state is OperatingState.ENABLED
    rig.engine.submit(name, value)
    rig.cycle()
    assert len(rig.written) == 1


def test_it_does_not_keep_a_velocity_going() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.3, 0.0))
    rig.cycle()
    rig.engine.submit("servo_jv", jv(0.4, 0.0))
    rig.cycle(period=HELD_UP)
    assert [setpoint.values[0] for setpoint in rig.written] == [0.3]
    assert rig.device.calls[-1] == "stop"


def test_a_machine_that_was_busy_for_a_moment_is_no_reason() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.3, 0.0))
    rig.cycle(period=0.3)
    assert rig.written[-1].values[0] == 0.3
