"""`enable(10); home(10); move_jp(goal).wait()` on every device, as `python -m bench.opening` for longer."""

import pytest

from bench.opening import DEVICES, opened, rounds
from rigs.ur_bench import lenient, patient_config

ROUNDS = {"loopback": 8, "virtual": 4}
"""A device; else 2: one that begins DISABLED and one that begins ENABLED."""


@pytest.mark.sweep(3)
@pytest.mark.parametrize("name", DEVICES)
def test_the_move_after_home_is_carried_out(name: str) -> None:
    config = patient_config(DEVICES[name].values) if name == "ur" else None
    with lenient(), opened(name, config) as (engine, arm):
        assert rounds(engine, arm, ROUNDS.get(name, 2), DEVICES[name].tolerance) == []
