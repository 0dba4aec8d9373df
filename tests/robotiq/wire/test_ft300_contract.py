"""The driver keeps the contract of every device, by stream and by registers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_robotiq.ft300 import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.robotiq.ft300 import SIM, RunningSim  # noqa: E402
from rigs.ft300_bench import FREE_PORTS, configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(3)

WAYS = (("serial", "stream"), ("tool", "stream"), ("modbus", "registers"))


@pytest.fixture(scope="module", params=WAYS, ids=lambda way: "-".join(way))
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, str, RunningSim]]:
    """A simulated sensor and the way to it; one for all tests."""
    with SIM.spawn(**FREE_PORTS) as sim:
        yield *request.param, sim


class TestFt300(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, simulated: tuple[str, str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        link, source, self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim, link=link, source=source))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("disconnect")
