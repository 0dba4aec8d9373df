"""Homing that is stopped half-way: what follows begins where the joints stand, not where homing began."""

from __future__ import annotations

import numpy as np
import pytest

from bench.reliability.activities import HOME
from bench.reliability.rig import PATIENCE
from bench.reliability.rigs import RIGS

HOMING = sorted(rig.name for rig in RIGS.values() if HOME in rig.activities)
FAR = 0.3
"""rad from where homing began."""
STEP = 0.05


@pytest.mark.parametrize("name", HOMING)
def test_after_hold_a_relative_move_begins_here(name: str) -> None:
    with RIGS[name]() as rig:
        rig.ready()
        began = rig.look().joints
        rig.begin_activity(HOME)
        rig.until(lambda: np.abs(rig.look().joints - began).max() > FAR, PATIENCE, "it is far away")
        rig.arm.hold()
        stood = rig.until_still()
        rig.until(lambda: rig.engine.transition_ended, PATIENCE, "homing has ended")
        assert rig.status.state == "ENABLED"
        assert not rig.status.is_homed
        back = np.zeros_like(stood)
        back[0] = -STEP if stood[0] > began[0] else STEP
        move = rig.arm.move_jr(back)
        rig.until(lambda: not move.is_busy(), PATIENCE, "the move ends")
        move.wait(0.0)
        assert np.abs(rig.until_still() - stood - back).max() < rig.tolerance
        rig.stop_activity()
