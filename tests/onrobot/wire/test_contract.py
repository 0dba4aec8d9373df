"""The driver keeps the contract of every device: fingers on two of the ways, and vacuum."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_onrobot import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.onrobot import SIM, RunningSim  # noqa: E402
from rigs.onrobot_bench import FREE_PORTS, configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(4)

CASES = (("rg2", "serial"), ("2fg7", "tool"), ("vg10", "modbus"))


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, str, RunningSim]]:
    """A simulated gripper and the way to it; one for all tests."""
    model, link = request.param
    with SIM.spawn(**FREE_PORTS, model=model) as sim:
        yield model, link, sim


class TestOnRobot(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG
    reach = 0.2

    @pytest.fixture
    def session(self, simulated: tuple[str, str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        model, link, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, model=model, link=link))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()
