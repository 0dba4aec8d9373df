"""The driver keeps the contract of every device, on each way to the gripper."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_robotiq.epick import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.robotiq.epick import SIM, RunningSim  # noqa: E402
from rigs.epick_bench import FREE_PORTS, configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(3)

LINKS = ("serial", "tool", "modbus")


@pytest.fixture(scope="module", params=LINKS)
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """A simulated gripper and the way to it; one for all tests."""
    with SIM.spawn(**FREE_PORTS) as sim:
        yield request.param, sim


class TestEpick(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG
    tolerance = 12_000.0  # Pa
    still = 1000.0

    @pytest.fixture
    def session(self, simulated: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        link, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, link=link))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("disconnect")
