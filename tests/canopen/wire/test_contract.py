"""The CANopen driver keeps the contract of every device, on simulated drives over the virtual bus."""

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_canopen import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.process import RunningSim  # noqa: E402
from rigs.canopen_arm import drives, patient_arm_on  # noqa: E402


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    """Simulated drives; the same for all tests."""
    with drives(3) as running:
        yield running


class TestCanopenContract(DeviceContract):
    timeout = 20.0

    @pytest.fixture
    def session(self, sim: RunningSim) -> Session:
        sim.control.clear()
        self.sim = sim
        return Session(PLUGIN, patient_arm_on(sim, 3))

    def break_link(self, session: Session) -> None:
        self.sim.control.inject("down")

    def mend_link(self, session: Session) -> None:
        self.sim.control.clear("down")
