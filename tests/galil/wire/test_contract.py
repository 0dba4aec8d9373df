"""The driver keeps the contract of every device, in each way of tracking."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_galil import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.galil import SIM, RunningSim  # noqa: E402
from rigs.galil_bench import configuration, joints  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(4)


@pytest.fixture(scope="module")
def simulated() -> Iterator[RunningSim]:
    """A simulated controller; one for all tests."""
    with SIM.spawn() as sim:
        yield sim


class TestGalil(DeviceContract):
    """Everything that any device must do, with PT."""

    timeout = LONG
    tracking = "pt"

    @pytest.fixture
    def session(self, simulated: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = simulated
        keys = joints(homing={"method": "here"}) if self.tracking == "pt" else joints()
        yield Session(PLUGIN, configuration(self.sim, tracking=self.tracking, joints=keys))
        self.sim.control.clear()

    def silence(self, session: Session) -> None:
        """It sends no data records, and answers no command."""
        self.inject(session, "no_records")
        self.inject(session, "mute")

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()


class TestGalilByPieces(TestGalil):
    """The same with PVT."""

    tracking = "pvt"
