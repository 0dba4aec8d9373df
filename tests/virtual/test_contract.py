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
        return Session(PLUGIN, VirtualConfig(rate=100.0, transition_time=0.05))

    def break_link(self, session: Session) -> None:
        self.device_of(session).reachable = False

    def mend_link(self, session: Session) -> None:
        self.device_of(session).reachable = True

    @staticmethod
    def device_of(session: Session) -> VirtualDevice:
        device = session.engine.device
        assert isinstance(device, VirtualDevice)
        return device


OF_A_MODEL = frozenset(
    {
        "test_enabling_moves_nothing_and_takes_the_measured_position",
        "test_servo_cp_is_followed",
        "test_move_jp_reaches_its_goal_with_a_pulse_of_busy",
        "test_hold_ends_a_move",
        "test_bad_commands_are_refused_and_leave_the_device_where_it_is",
        "test_kinematics_agree_with_each_other_and_with_the_measurement",
        "test_a_lost_link_is_a_fault_and_its_return_moves_and_enables_nothing",
    }
)
"""Of which the other tests of the first model are no quick brothers."""


class TestVirtualSevenAxisThatNeedsHoming(TestVirtual):
    quick = OF_A_MODEL

    @pytest.fixture
    def session(self) -> Session:
        config = VirtualConfig(
            model="seven_axis", needs_homing=True, rate=100.0, transition_time=0.05
        )
        return Session(PLUGIN, config)


class TestVirtualHaptic(TestVirtual):
    quick = OF_A_MODEL

    @pytest.fixture
    def session(self) -> Session:
        return Session(PLUGIN, VirtualConfig(model="haptic", rate=100.0, transition_time=0.05))
