"""The driver keeps the contract of every device, in both protocols."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_weiss_wsg import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.weiss_wsg import SIM, RunningSim  # noqa: E402
from rigs.waiting import LONG  # noqa: E402
from rigs.wsg_bench import FREE_PORTS, configuration  # noqa: E402

pytestmark = pytest.mark.sweep(4)


@pytest.fixture(scope="module", params=["tcp", "text"])
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """A simulated gripper and the way to it; one for all tests."""
    with SIM.spawn(**FREE_PORTS) as sim:
        yield request.param, sim


class TestWsg(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG
    reach = 0.2

    @pytest.fixture
    def session(self, simulated: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        link, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, link=link))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out, and the gripper stops fast."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()
