"""Homing whose link is lost: nobody can stop it, and whoever closes the driver is warned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import pytest

from bench.reliability.activities import HOME
from bench.reliability.rig import PATIENCE
from bench.reliability.rigs import RIGS
from crtk_drivers.errors import StopUnconfirmed

LOST: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "galil": ("disconnect", {"port": "command"}),
    "copley": ("silence", {"port": "serial"}),
    "canopen": ("silent", {}),
}
"""Faults of simulators by which their link is lost."""


def test_each_driver_that_homes_is_in_the_table() -> None:
    assert set(LOST) == {rig.name for rig in RIGS.values() if HOME in rig.activities}


@pytest.mark.sweep(2)
@pytest.mark.parametrize("name", LOST)
def test_close_says_that_homing_was_not_stopped(name: str) -> None:
    kind, parameters = LOST[name]
    with RIGS[name]() as rig:
        rig.ready()
        rig.begin_activity(HOME)
        rig.inject(kind, **parameters)
        rig.until(lambda: not rig.connected, PATIENCE, "the link is lost")
        with pytest.raises(StopUnconfirmed):
            rig.driver.close()
        rig.end_fault()
