"""The stage in simulated worlds: in a fair one, and where much goes wrong. One number gives one world."""

import pytest
import stage_worlds

from crtk_drivers.testing import world


@pytest.mark.parametrize("seed", range(3))
def test_a_fair_day_has_no_findings(seed: int) -> None:
    """Nothing goes wrong but what the scenario does itself."""
    world.run(stage_worlds.working_day, seed=seed).check()


@pytest.mark.parametrize("seed", range(10))
def test_a_wild_day_has_no_findings(seed: int) -> None:
    """Bad weather, lost connections, processes and threads that stand still, a clock that is set."""
    world.run(stage_worlds.working_day, seed=seed, wild=True).check()


@pytest.mark.parametrize("seed", range(5))
def test_any_use_has_no_findings(seed: int) -> None:
    """The promises of all devices, whatever a user does."""
    world.run(stage_worlds.any_use, seed=seed, wild=True).check()


def test_a_seed_gives_the_same_day_again() -> None:
    """Each decision and each byte: this is how a finding is looked at again."""
    first, again = (world.run(stage_worlds.working_day, seed=1, wild=True) for _ in range(2))
    assert (first.hash, first.story) == (again.hash, again.story)
