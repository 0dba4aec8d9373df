"""The driver keeps the contract of every device, by points and by profiles."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_copley import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.copley import SIM, RunningSim  # noqa: E402
from rigs.copley_bench import configuration, joints  # noqa: E402
from rigs.waiting import LONG  # noqa: E402


@pytest.fixture(scope="module")
def simulated() -> Iterator[RunningSim]:
    """Simulated drives; the same for all tests."""
    with SIM.spawn() as sim:
        yield sim


class TestCopley(DeviceContract):
    """Everything that any device must do, by points."""

    timeout = LONG
    tracking = "pvt"
    quick = frozenset(
        {
            "test_connecting_enables_nothing_and_moves_nothing",
            "test_enabling_moves_nothing_and_takes_the_measured_position",
            "test_stamps_are_of_now_and_increase",
            "test_hold_ends_a_move",
            "test_stop_may_come_from_any_thread",
            "test_a_lost_link_is_a_fault_and_its_return_moves_and_enables_nothing",
        }
    )
    """Of which nothing else here is the quick brother."""

    @pytest.fixture
    def session(self, simulated: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = simulated
        keys = joints(homing={"method": "here"}) if self.tracking == "pvt" else joints()
        yield Session(PLUGIN, configuration(self.sim, tracking=self.tracking, joints=keys))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The adapter is pulled out."""
        self.sim.control.inject("disconnect", port="serial")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()


@pytest.mark.slow
class TestCopleyByProfiles(TestCopley):
    """The same by the drive's own ramps."""

    tracking = "profile"
