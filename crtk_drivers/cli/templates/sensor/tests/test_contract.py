"""The sensor against the contract of crtk-drivers, and what the contract cannot know."""

import time

import pytest
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import SimControl
from crtk_drivers.session import Session, open_session
from crtk_drivers.testing.contract import DeviceContract

from crtk_driver_my_sensor.config import MySensorConfig


def control(session: Session) -> SimControl:
    """By which faults begin and end in the simulator."""
    assert session.sim is not None
    return session.sim.control


class TestMySensor(DeviceContract):
    """Everything that any device must do."""

    @pytest.fixture
    def session(self) -> Session:
        """A sensor at its simulator, with 5 N on it; a busy machine is no fault."""
        config = MySensorConfig(sample_timeout=2.0)
        return open_session("my_sensor", config, sim=True, sim_options={"load": 5.0})

    def break_link(self, session: Session) -> None:
        """Nobody is at the other end any more."""
        control(session).inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """The sensor is there again."""
        control(session).clear("disconnect")

    def test_it_measures_and_tares(self, arm: LocalDevice) -> None:
        """In N along z."""
        assert arm.measured_cf().force == pytest.approx([0.0, 0.0, 5.0], abs=0.02)
        assert arm.tare() == "the present load is zero"
        self.wait_samples(arm, 2)
        assert arm.measured_cf().force == pytest.approx([0.0, 0.0, 0.0], abs=0.02)

    def test_what_it_measures_is_new_after_it_tared(self, session: Session) -> None:
        """No acknowledgement is taken for an answer: later answers would be late."""
        device, deadline = session.engine.device, time.monotonic() + self.timeout
        try:
            device.open(deadline)
            for _ in range(5):
                for _ in device.services["tare"].run():
                    device.read(deadline)
            control(session).inject("load", force=50.0)
            device.read(deadline)  # of one that streams, this may be under way already
            sample = device.read(deadline)
        finally:
            device.close()
            session.close()
        assert sample is not None
        assert sample.values["measured_cf"].force[2] == pytest.approx(50.0, abs=0.1)

    def test_an_overload_is_told(self, arm: LocalDevice, session: Session) -> None:
        """As a reading of its own."""
        control(session).inject("load", force=300.0)
        self.until(arm.state.overload, "tell that it is overloaded")

    def test_a_sensor_that_falls_silent_is_lost(self, arm: LocalDevice, session: Session) -> None:
        """The line is there, and nothing comes."""
        control(session).inject("deaf")
        assert arm.wait_for_operating_state("FAULT", self.timeout)
