"""The driver keeps the contract of every device."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_force_dimension import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from rigs.haptic_bench import RunningSim, configured, haptic_sim, needs_compiler  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = [needs_compiler, pytest.mark.slow]


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    """One for all tests."""
    with haptic_sim(model="sigma.7") as running:
        yield running


class TestForceDimension(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, sim: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = sim
        yield Session(PLUGIN, PLUGIN.sim_config(configured(model="sigma.7"), sim))
        sim.control.clear()

    def break_link(self, session: Session) -> None:
        """It is unplugged."""
        self.sim.control.inject("unplugged")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("unplugged")
