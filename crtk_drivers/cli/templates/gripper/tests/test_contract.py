"""The gripper against the contract of crtk-drivers, and what the contract cannot know."""

import pytest
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import SimControl
from crtk_drivers.session import Session, open_session
from crtk_drivers.testing.contract import DeviceContract

from crtk_driver_my_gripper.config import MyGripperConfig


def control(session: Session) -> SimControl:
    """By which faults begin and end in the simulator."""
    assert session.sim is not None
    return session.sim.control


class TestMyGripper(DeviceContract):
    """Everything that any device must do."""

    tolerance = 1e-3
    still = 5e-4
    reach = 0.1

    @pytest.fixture
    def session(self) -> Session:
        """A gripper at its simulator. That a busy machine lets it wait is no fault."""
        return open_session("my_gripper", MyGripperConfig(sample_timeout=2.0), sim=True)

    def break_link(self, session: Session) -> None:
        """The adapter is unplugged."""
        control(session).inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        control(session).clear("disconnect")

    def test_what_is_held_is_told(self, enabled: LocalDevice, session: Session) -> None:
        """The fingers close on it."""
        control(session).inject("object", width=0.03)
        enabled.move_jp([0.029])
        self.until(enabled.state.holds, "tell that it holds something")
        enabled.hold()
        enabled.disable()
        assert enabled.state.holds(), "what it holds is never let go by itself"
        control(session).inject("object_lost")
        self.until(lambda: enabled.state.grip() == "object lost", "tell that it is gone")

    def test_a_gripper_that_falls_silent_is_lost(
        self, enabled: LocalDevice, session: Session
    ) -> None:
        """The line stays open, and nothing comes."""
        control(session).inject("deaf")
        assert enabled.wait_for_operating_state("FAULT", self.timeout)
