"""The contract, on the device without hardware: the pattern for every other driver's contract test."""

import pytest

from crtk_drivers.session import Session
from crtk_drivers.testing.contract import DeviceContract
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice


class TestLoopback(DeviceContract):
    @pytest.fixture
    def session(self) -> Session:
        return Session(PLUGIN, LoopbackConfig(rate=200.0))

    def break_link(self, session: Session) -> None:
        self.device_of(session).reachable = False

    def mend_link(self, session: Session) -> None:
        self.device_of(session).reachable = True

    @staticmethod
    def device_of(session: Session) -> LoopbackDevice:
        device = session.engine.device
        assert isinstance(device, LoopbackDevice)
        return device


class TestLoopbackThatNeedsHoming(TestLoopback):
    @pytest.fixture
    def session(self) -> Session:
        config = LoopbackConfig(rate=200.0, needs_homing=True, transition_time=0.05)
        return Session(PLUGIN, config)
