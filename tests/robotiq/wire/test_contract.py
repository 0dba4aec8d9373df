"""The driver keeps the contract of every device, on each way to the gripper."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_robotiq import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.robotiq import SIM, RunningSim  # noqa: E402
from rigs.robotiq_bench import FREE_PORTS, LINKS, configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(4)


@pytest.fixture(scope="module", params=LINKS)
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """A simulated gripper and the way to it; one for all tests."""
    with SIM.spawn(**FREE_PORTS) as sim:
        yield request.param, sim


class TestRobotiq(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG
    reach = 0.2

    @pytest.fixture
    def session(self, simulated: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        self.link, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, link=self.link))
        self.sim.control.clear()

    def damage(self, session: Session) -> None:
        """The URCap's text has no check of its own, and TCP delivers nothing that is damaged."""
        if self.link == "urcap":
            pytest.skip("what is no answer of the URCap ends its connection")
        super().damage(session)

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()
