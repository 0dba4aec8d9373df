"""The driver keeps the contract of every device: where an arm is only read, and where it is driven."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_dvrk import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.dvrk import SIM, RunningSim  # noqa: E402
from rigs.dvrk_bench import DRIVEN, UNHURRIED, configuration, set_encoders  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(4)


@pytest.fixture(scope="module")
def simulated() -> Iterator[RunningSim]:
    """A simulated controller; one for all tests."""
    with SIM.spawn() as sim:
        yield sim


class TestDvrk(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, simulated: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = simulated
        yield Session(PLUGIN, configuration(self.sim))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("silence")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()


@pytest.fixture(scope="module")
def powered() -> Iterator[RunningSim]:
    """The same for an arm that is driven, its encoders set."""
    with SIM.spawn(**UNHURRIED) as sim:
        set_encoders(sim)
        yield sim


@pytest.mark.slow
class TestDriven(TestDvrk):
    """The same of one that takes efforts."""

    @pytest.fixture
    def session(self, powered: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = powered
        yield Session(PLUGIN, configuration(self.sim, **DRIVEN))
        self.sim.control.clear()
