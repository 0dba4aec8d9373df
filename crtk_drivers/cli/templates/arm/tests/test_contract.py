"""The arm against the contract of crtk-drivers, and what the contract cannot know."""

import pytest
from crtk_drivers.errors import DeviceFault, TransitionFailed, raise_first
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import SimControl
from crtk_drivers.session import Session, open_session
from crtk_drivers.testing.contract import DeviceContract

from crtk_driver_my_arm.config import MyArmConfig


def control(session: Session) -> SimControl:
    """By which faults begin and end in the simulator."""
    assert session.sim is not None
    return session.sim.control


class TestMyArm(DeviceContract):
    """Everything that any device must do."""

    @pytest.fixture
    def session(self) -> Session:
        """An arm at its simulator. That a busy machine lets it wait is no fault."""
        return open_session("my_arm", MyArmConfig(sample_timeout=2.0), sim=True)

    def break_link(self, session: Session) -> None:
        """The arm closes the connection and accepts none."""
        control(session).inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It accepts connections again."""
        control(session).clear("disconnect")

    def test_an_overload_is_a_fault_until_it_is_gone(
        self, enabled: LocalDevice, session: Session
    ) -> None:
        """The hardware's own words reach the user."""
        control(session).inject("overload")
        assert enabled.wait_for_operating_state("FAULT", self.timeout)
        assert enabled.operating_state().detail == "motor overload"
        with pytest.raises(DeviceFault, match="motor overload"):
            raise_first(enabled.engine.device.obstacles)  # which `crtk-driver check` shows
        with pytest.raises(TransitionFailed, match="motor overload"):
            enabled.enable()
        control(session).clear("overload")
        self.until(lambda: not enabled.engine.device.condition.reason, "tell that it is gone")
        enabled.enable()

    def test_an_arm_that_falls_silent_is_lost(self, enabled: LocalDevice, session: Session) -> None:
        """The connection stays open, and nothing comes."""
        control(session).inject("silence")
        assert enabled.wait_for_operating_state("FAULT", self.timeout)
