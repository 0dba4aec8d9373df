"""The stage against the contract of crtk-drivers, over TCP, and what the contract cannot know."""

import pytest
from crtk_driver_one_axis.config import OneAxisConfig

import crtk_drivers
from crtk_drivers.errors import ConfigError, DeviceFault, TransitionFailed, raise_first
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session, open_session
from crtk_drivers.testing.contract import DeviceContract


class TestOneAxis(DeviceContract):
    """Everything that any device must do."""

    tolerance = 1e-3
    still = 5e-4

    @pytest.fixture
    def session(self) -> Session:
        """A stage at its simulator."""
        return open_session("one_axis", OneAxisConfig(), sim=True)

    def break_link(self, session: Session) -> None:
        """The stage closes the connection and accepts none."""
        assert session.sim is not None
        session.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It accepts connections again."""
        assert session.sim is not None
        session.sim.control.clear("disconnect")

    def test_an_overload_is_a_fault_until_it_is_gone(
        self, enabled: LocalDevice, session: Session
    ) -> None:
        """The hardware's own words reach the user."""
        assert session.sim is not None
        session.sim.control.inject("overload")
        assert enabled.wait_for_operating_state("FAULT", self.timeout)
        assert enabled.operating_state().detail == "motor overload"
        with pytest.raises(DeviceFault, match="motor overload"):
            raise_first(enabled.engine.device.obstacles)  # which `crtk-driver check` shows
        with pytest.raises(TransitionFailed, match="motor overload"):
            enabled.enable()
        session.sim.control.clear("overload")
        self.until(lambda: not enabled.engine.device.obstacles, "report that it is gone")
        enabled.enable()

    def test_a_stage_that_falls_silent_is_lost(
        self, enabled: LocalDevice, session: Session
    ) -> None:
        """The connection stays open, and nothing comes."""
        assert session.sim is not None
        session.sim.control.inject("silence")
        assert enabled.wait_for_operating_state("FAULT", self.timeout)
        assert "old" in enabled.operating_state().detail


def test_the_plugin_is_found_by_its_name() -> None:
    """Entry points, configuration and simulator fit together."""
    with crtk_drivers.connect("one_axis", sim=True, travel=0.8) as stage:
        stage.enable()
        assert stage.move_jp([0.5]).wait(10.0)


def test_a_real_stage_needs_an_address() -> None:
    """Said before anything is tried."""
    with pytest.raises(ConfigError, match="host: is required"):
        crtk_drivers.connect("one_axis")
