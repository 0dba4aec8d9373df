"""The virtual arm keeps the contract of every device, each of its models."""

import pytest

pytest.importorskip("pinocchio")

from crtk_driver_virtual import PLUGIN
from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.device import VirtualDevice
from crtk_drivers.session import Session
from crtk_drivers.testing.contract import DeviceContract


class TestVirtual(DeviceContract):
    @pytest.fixture
    def session(self) -> Session:
        return Session(PLUGIN, VirtualConfig(transition_time=0.05))

    def break_link(self, session: Session) -> None:
        self.device_of(session).reachable = False

    def mend_link(self, session: Session) -> None:
        self.device_of(session).reachable = True

    @staticmethod
    def device_of(session: Session) -> VirtualDevice:
        device = session.engine.device
        assert isinstance(device, VirtualDevice)
        return device


class TestVirtualSevenAxisThatNeedsHoming(TestVirtual):
    @pytest.fixture
    def session(self) -> Session:
        config = VirtualConfig(model="seven_axis", needs_homing=True, transition_time=0.05)
        return Session(PLUGIN, config)


class TestVirtualHaptic(TestVirtual):
    @pytest.fixture
    def session(self) -> Session:
        return Session(PLUGIN, VirtualConfig(model="haptic", transition_time=0.05))
