"""The driver keeps the contract of every device, with each kind of sensor."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_optoforce import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.optoforce import SIM, RunningSim  # noqa: E402
from rigs.optoforce_bench import configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(3)


@pytest.fixture(scope="module", params=["3-axis", "6-axis", "4x3-axis"])
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """A simulated unit and what hangs at it; one for all tests."""
    with SIM.spawn(sensor=request.param) as sim:
        yield request.param, sim


class TestOptoForce(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, simulated: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        sensor, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, sensor=sensor))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """It is unplugged."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("disconnect")
