"""Raven keeps the contract of every device, as far as one can that tells nothing."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_raven import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.raven import SIM, RunningSim  # noqa: E402
from rigs.raven_bench import configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(3)


@pytest.fixture(scope="module")
def simulated() -> Iterator[RunningSim]:
    """A simulated Raven, for all tests."""
    with SIM.spawn(port=0) as sim:
        yield sim


class TestRaven(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, simulated: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = simulated
        yield Session(PLUGIN, configuration(simulated))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """Its software ends."""
        self.sim.control.inject("closed")

    def mend_link(self, session: Session) -> None:
        """It runs again."""
        self.sim.control.clear("closed")
