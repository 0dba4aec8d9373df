"""`obstacles`: what would refuse `enable` is known before, so that ``crtk-driver check`` can say it.

Every state in which a driver of the table of faults may find its hardware is met while it is DISABLED. What
`check` would say then is held against what `enable` does.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import pytest

from bench.reliability.rig import PATIENCE, SLACK, Rig
from bench.reliability.rigs import RIGS
from bench.reliability.table import Follows, Way
from crtk_drivers.errors import CrtkError
from rigs.fault_rigs import FaultRigs

STATES: Final = frozenset({"F6", "F9", "F10", "F11", "F12", "F13", "F14"})
"""The faults that are states of the hardware, and not of a link, a stream or a program."""

UNKNOWABLE: Final[Mapping[tuple[str, str], str]] = MappingProxyType(
    {
        ("canopen", "a node does not hear its setpoints"): "it answers none before it has power",
        ("canopen", "motor supply is off"): "most drives say so only when they are switched on",
        ("canopen", "safe torque off"): "most drives say so only when they are switched on",
        ("canopen", "local control"): "bit 9 is 0 on some drives that obey: a note says it",
        ("galil", "its motor loses its power"): "it says so only after SH",
        ("openhaptics", "a force error"): "the library says so only when forces are switched on",
        ("dvrk-driven", "an amplifier is too hot"): "it says so only when it is switched on",
        ("dvrk-driven", "motors have no voltage"): "`enable` switches their power on, and measures",
        ("dvrk-driven", "the safety relay opens"): "`enable` closes it, and looks whether it did",
    }
)
"""What no driver can know before it powers its hardware, by driver and way, and why."""

CASES: Final = [
    pytest.param(rig.name, way, id=f"{rig.name}-{way.name}".replace(" ", "_"))
    for rig in RIGS.values()
    for way in rig.ways
    if way.follows is Follows.STOPS and way.fault in STATES and not way.kind.startswith("own")
]


def _is_ready(rig: Rig) -> bool:
    """Return whether ``crtk-driver check`` would call the device ready."""
    in_fault = str(rig.status.state) == "FAULT"
    return rig.connected and not in_fault and not rig.engine.device.obstacles


def _enables(rig: Rig) -> bool:
    try:
        rig.arm.enable(timeout=PATIENCE)
    except CrtkError:
        return False
    return True


@pytest.mark.sweep(5)
@pytest.mark.parametrize(("driver", "way"), CASES)
def test_enable_refuses_nothing_that_check_passes(rigs: FaultRigs, driver: str, way: Way) -> None:
    rig = rigs.of(driver)
    try:
        rig.ready()
        rig.arm.disable()
        rig.begin_fault(way)
        deadline = time.monotonic() + way.within + SLACK
        while _is_ready(rig) and time.monotonic() < deadline:
            rig.step()
        is_ready, obstacles = _is_ready(rig), rig.engine.device.obstacles
        is_enabled = _enables(rig)
        if is_ready and (driver, way.name) not in UNKNOWABLE:
            assert is_enabled, rig.status
        assert not (obstacles and is_enabled), obstacles
        rig.end_fault()
    except BaseException:
        rigs.drop()
        raise
