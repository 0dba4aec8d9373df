"""The devices of this distribution, and what `connect` returns for each."""

# Written by `python -m crtk_drivers.cli.type_stubs`, from the command table.

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, overload

from numpy.typing import ArrayLike

from crtk_drivers.front.kinds import (
    AnyDevice,
    Arm,
    ForceSensor,
    Gripper,
    HapticDevice,
    InputDevice,
    Tracker,
)
from crtk_drivers.front.local import LocalDevice, LocalFront
from crtk_drivers.front.payloads import PoseLike, WrenchLike
from crtk_drivers.samples import JointState, Joy, Pose

__all__ = [
    "AtiNetft",
    "Canopen",
    "Copley",
    "Dvrk",
    "Dynamixel",
    "ForceDimension",
    "Galil",
    "Haply",
    "Inputs",
    "LocalDevice",
    "Loopback",
    "Ndi",
    "Onrobot",
    "Openhaptics",
    "Optoforce",
    "Raven",
    "Robotiq",
    "RobotiqEpick",
    "RobotiqFt300",
    "Ros2Control",
    "Schunk",
    "SchunkFts",
    "Ur",
    "Virtual",
    "WeissWsg",
    "connect",
]

class AtiNetft(LocalFront, ForceSensor):
    """ATI NetFT force/torque sensors: Net Box, Ethernet Axia, SCHUNK FTN, OnRobot HEX."""

    def bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in software.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def unbias(self, timeout: float = 30.0) -> str:
        """Remove the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def get_bias(self, timeout: float = 30.0) -> str:
        """Tell the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in the sensor.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_unbias(self, timeout: float = 30.0) -> str:
        """Remove the sensor's own bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def clear_latch(self, timeout: float = 30.0) -> str:
        """Clear the latched monitor condition.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def calibration_add(self, timeout: float = 30.0) -> str:
        """Average the load in the present pose, for calibration_finish.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def calibration_finish(self, timeout: float = 30.0) -> str:
        """Find tool and bias from the poses, and take them off.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def calibration_clear(self, timeout: float = 30.0) -> str:
        """Forget the poses.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def record_start(self, timeout: float = 30.0) -> str:
        """Write every measurement to a new file.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def record_stop(self, timeout: float = 30.0) -> str:
        """End the recording.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def set_bias(self, value: WrenchLike, /) -> None:
        """Software bias, in the sensor's frame.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def orientation(self, value: PoseLike, /) -> None:
        """Pose of the sensor, or of what it is mounted on, in a frame at rest.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class Canopen(LocalFront, Arm):
    """CANopen servo drives (CiA 402) on a CAN bus as one arm."""

class Copley(LocalFront, Arm):
    """Copley Controls drives (Accelnet, Xenus, ...) by ASCII over serial: their axes as one arm."""

class DvrkState(Protocol):
    """What the device tells beyond CRTK."""

    def motor_power(self) -> bool:
        """Whether all motors have their voltage.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def safety_relay(self) -> bool:
        """Whether all safety relays are closed.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def watchdog_expired(self) -> bool:
        """Whether the watchdog of a board has expired.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def currents(self) -> tuple[float, ...]:
        """Current of each actuator, A.

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def amplifiers(self) -> tuple[float, ...]:
        """1 for each actuator whose amplifier is on.

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def temperatures(self) -> tuple[float, ...]:
        """°C of the amplifiers: two for each board.

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def potentiometers(self) -> tuple[float, ...]:
        """What each potentiometer measures, rad (m).

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def psm1_suj_clutch(self) -> bool:
        """Whether PSM1_SUJ_clutch is pressed.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def psm1_manip_clutch(self) -> bool:
        """Whether PSM1_manip_clutch is pressed.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

class Dvrk(LocalFront, Arm):
    """Controllers of da Vinci Research Kits (FPGA1394, QLA, firmware 8): an arm is read, or driven."""

    @property
    def state(self) -> DvrkState:
        """What the device tells beyond CRTK."""

    @overload
    def measured2_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> JointState:
        """Return the measured joint state.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            JointState: position (n,) in rad (m), velocity (n,) in rad/s (m/s), effort (n,) in N·m
                (N).

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured2_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[JointState, float]: ...

class Dynamixel(LocalFront, Arm):
    """DYNAMIXEL servo chains: X, MX, P, AX and RX series on RS-485 or TTL, with a gripper."""

class ForceDimensionState(Protocol):
    """What the device tells beyond CRTK."""

    def gravity_compensation(self) -> bool:
        """Whether it carries its own weight.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def fixtures(self) -> str:
        """Fixtures that count now.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

class ForceDimension(LocalFront, HapticDevice):
    """Force Dimension's omega, delta, sigma, lambda, and the Falcon, with a local force loop."""

    @property
    def state(self) -> ForceDimensionState:
        """What the device tells beyond CRTK."""

    def clear_fixtures(self, timeout: float = 30.0) -> str:
        """Take all fixtures away.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def fixtures(self, value: str, /) -> None:
        """What pulls and pushes the hand: JSON, see docs/haptics.md.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def button(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

class Galil(LocalFront, Arm):
    """Galil DMC motion controllers (40x0, 41x3, 52xx0, 30000, ...): their axes as one arm."""

class HaplyState(Protocol):
    """What the device tells beyond CRTK."""

    def battery(self) -> float:
        """Charge of the grip, 0 to 1.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def awake(self) -> bool:
        """Whether the grip measures.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def calibrated(self) -> bool:
        """Whether positions count.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

class Haply(LocalFront, HapticDevice):
    """Haply Inverse3 with VerseGrip by Haply's Inverse service: pose, buttons, forces."""

    @property
    def state(self) -> HaplyState:
        """What the device tells beyond CRTK."""

    def button_a(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

    def button_b(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

    def button_c(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

    def button_home(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

class Inputs(LocalFront, InputDevice):
    """Foot pedals, joysticks, six-axis mice: event and joystick devices of Linux, spacenavd."""

    def joy(self) -> Joy:
        """All axes, -1 to 1, and the pedals in the order of their names in the settings.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

class Loopback(LocalFront, Arm):
    """A gantry that exists in memory only, for tests and as a pattern for plugins."""

class NdiState(Protocol):
    """What the device tells beyond CRTK."""

    def tools_in_view(self) -> float:
        """How many tools have a pose.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def stray_markers(self) -> float:
        """How many markers belong to no tool.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

class Ndi(LocalFront, Tracker):
    """NDI trackers: Polaris Vicra, Spectra, Vega, Lyra, and Aurora, over serial or TCP."""

    @property
    def state(self) -> NdiState:
        """What the device tells beyond CRTK."""

    def beep(self, timeout: float = 30.0) -> str:
        """Beep once.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

class OnrobotState(Protocol):
    """What the device tells beyond CRTK."""

    def holds(self) -> bool:
        """Whether it holds something.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def grip(self) -> str:
        """What it does.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def fault(self) -> str:
        """What it reports; empty: nothing.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def range(self) -> tuple[float, ...]:
        """Least and greatest opening, in m.

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool(self) -> str:
        """Which one is there.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

class Onrobot(LocalFront, Gripper):
    """OnRobot grippers: RG2, RG6, 2FG7, 2FG14, 3FG15, VG10, VGC10; Compute Box, serial, tool line."""

    @property
    def state(self) -> OnrobotState:
        """What the device tells beyond CRTK."""

    def power_cycle(self, timeout: float = 30.0) -> str:
        """Have the Compute Box take the tool's power away and give it back: clears latched faults.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def force(self, value: float, /) -> None:
        """Force of the next motions in N, 3 to 40.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class OpenhapticsState(Protocol):
    """What the device tells beyond CRTK."""

    def fixtures(self) -> str:
        """Fixtures that count now.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

class Openhaptics(LocalFront, HapticDevice):
    """Touch, Omni and other haptic devices of OpenHaptics, with a local force loop."""

    @property
    def state(self) -> OpenhapticsState:
        """What the device tells beyond CRTK."""

    def clear_fixtures(self, timeout: float = 30.0) -> str:
        """Take all fixtures away.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def fixtures(self, value: str, /) -> None:
        """What pulls and pushes the hand: JSON, see docs/haptics.md.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def front(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

    def back(self) -> Joy:
        """1 while it is pressed.

        Returns:
            Joy: axes from -1 to 1, buttons 1 (pressed) or 0.

        Raises:
            DataTimeout: it is not known now.
        """

class Optoforce(LocalFront, ForceSensor):
    """OptoForce force sensors at USB: 3 axes, 6 axes, four times 3 axes."""

    def bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in software.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def unbias(self, timeout: float = 30.0) -> str:
        """Remove the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def get_bias(self, timeout: float = 30.0) -> str:
        """Tell the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in the unit.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_unbias(self, timeout: float = 30.0) -> str:
        """Remove the unit's own zero.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def set_bias(self, value: WrenchLike, /) -> None:
        """Software bias, in the sensor's frame.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class Raven(LocalFront, AnyDevice):
    """Raven II by its teleoperation packets: one way, increments of both arms and jaws."""

    @property
    def gold(self) -> LocalDevice:
        """The device in `gold/`."""

    @property
    def green(self) -> LocalDevice:
        """The device in `green/`."""

class RobotiqState(Protocol):
    """What the device tells beyond CRTK."""

    def holds(self) -> bool:
        """Whether it holds something.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def grip(self) -> str:
        """What it does.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def fault(self) -> str:
        """What it reports; empty: nothing.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def current(self) -> float:
        """Of the motor, in A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

class Robotiq(LocalFront, Gripper):
    """Robotiq grippers: 2F-85, 2F-140, Hand-E; serial, robot's tool line, Modbus TCP, URCap."""

    @property
    def state(self) -> RobotiqState:
        """What the device tells beyond CRTK."""

    def activate(self, timeout: float = 30.0) -> str:
        """Reset it and activate it, which opens and closes it fully and drops what it holds.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def force(self, value: float, /) -> None:
        """Force of the next motions: 0 (the least) to 1 (the greatest).

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class RobotiqEpickState(Protocol):
    """What the device tells beyond CRTK."""

    def holds(self) -> bool:
        """Whether it holds something.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def grip(self) -> str:
        """What it does.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def fault(self) -> str:
        """What it reports; empty: nothing.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def pressure(self) -> float:
        """At the cups, absolute, in Pa.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

class RobotiqEpick(LocalFront, Gripper):
    """Robotiq vacuum gripper ePick; serial, robot's tool line, Modbus TCP."""

    @property
    def state(self) -> RobotiqEpickState:
        """What the device tells beyond CRTK."""

    def activate(self, timeout: float = 30.0) -> str:
        """Reset it and activate it, which lets go of what it holds.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

class RobotiqFt300(LocalFront, ForceSensor):
    """Robotiq force sensors: FT 300, FT 300-S; serial, robot's tool line, Modbus TCP."""

    def bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in software.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def unbias(self, timeout: float = 30.0) -> str:
        """Remove the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def get_bias(self, timeout: float = 30.0) -> str:
        """Tell the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def set_bias(self, value: WrenchLike, /) -> None:
        """Software bias, in the sensor's frame.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class Ros2Control(LocalFront, Arm):
    """Robots behind ros2_control: forward controllers, trajectory controller, hardware life cycle."""

class SchunkState(Protocol):
    """What the device tells beyond CRTK."""

    def holds(self) -> bool:
        """Whether it holds something.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def grip(self) -> str:
        """What it does.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def fault(self) -> str:
        """What it reports; empty: nothing.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

class Schunk(LocalFront, Gripper):
    """SCHUNK grippers EGU, EGK, EZU: their web server, Modbus RTU, robot's tool line."""

    @property
    def state(self) -> SchunkState:
        """What the device tells beyond CRTK."""

    def fast_stop(self, timeout: float = 30.0) -> str:
        """Stop it as fast as it can, in any state; enable acknowledges that.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def release(self, timeout: float = 30.0) -> str:
        """Let go of what it holds, by its own distance.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def brake_test(self, timeout: float = 30.0) -> str:
        """Test its brake, with nothing held.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def soft_reset(self, timeout: float = 30.0) -> str:
        """Start its electronics anew, with nothing held.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def force(self, value: float, /) -> None:
        """Force in N of the next grips at the closed end.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class SchunkFts(LocalFront, ForceSensor):
    """SCHUNK force/torque sensors FTS at their Ethernet box."""

    def bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in software.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def unbias(self, timeout: float = 30.0) -> str:
        """Remove the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def get_bias(self, timeout: float = 30.0) -> str:
        """Tell the software bias.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_bias(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in the sensor (tare).

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def sensor_unbias(self, timeout: float = 30.0) -> str:
        """Remove the sensor's own tare.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def set_bias(self, value: WrenchLike, /) -> None:
        """Software bias, in the sensor's frame.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class UrState(Protocol):
    """What the device tells beyond CRTK."""

    def digital_in_0(self) -> bool:
        """Whether input 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_1(self) -> bool:
        """Whether input 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_2(self) -> bool:
        """Whether input 2 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_3(self) -> bool:
        """Whether input 3 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_4(self) -> bool:
        """Whether input 4 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_5(self) -> bool:
        """Whether input 5 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_6(self) -> bool:
        """Whether input 6 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_in_7(self) -> bool:
        """Whether input 7 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_0(self) -> bool:
        """Whether configurable input 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_1(self) -> bool:
        """Whether configurable input 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_2(self) -> bool:
        """Whether configurable input 2 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_3(self) -> bool:
        """Whether configurable input 3 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_4(self) -> bool:
        """Whether configurable input 4 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_5(self) -> bool:
        """Whether configurable input 5 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_6(self) -> bool:
        """Whether configurable input 6 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_in_7(self) -> bool:
        """Whether configurable input 7 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_in_0(self) -> bool:
        """Whether tool input 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_in_1(self) -> bool:
        """Whether tool input 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_0(self) -> bool:
        """Whether output 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_1(self) -> bool:
        """Whether output 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_2(self) -> bool:
        """Whether output 2 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_3(self) -> bool:
        """Whether output 3 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_4(self) -> bool:
        """Whether output 4 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_5(self) -> bool:
        """Whether output 5 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_6(self) -> bool:
        """Whether output 6 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def digital_out_7(self) -> bool:
        """Whether output 7 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_0(self) -> bool:
        """Whether configurable output 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_1(self) -> bool:
        """Whether configurable output 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_2(self) -> bool:
        """Whether configurable output 2 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_3(self) -> bool:
        """Whether configurable output 3 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_4(self) -> bool:
        """Whether configurable output 4 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_5(self) -> bool:
        """Whether configurable output 5 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_6(self) -> bool:
        """Whether configurable output 6 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def configurable_out_7(self) -> bool:
        """Whether configurable output 7 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_out_0(self) -> bool:
        """Whether tool output 0 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_out_1(self) -> bool:
        """Whether tool output 1 is on.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_in_0_voltage(self) -> float:
        """Voltage of analog in 0, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_in_0_current(self) -> float:
        """Current of analog in 0, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_in_1_voltage(self) -> float:
        """Voltage of analog in 1, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_in_1_current(self) -> float:
        """Current of analog in 1, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_out_0_voltage(self) -> float:
        """Voltage of analog out 0, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_out_0_current(self) -> float:
        """Current of analog out 0, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_out_1_voltage(self) -> float:
        """Voltage of analog out 1, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def analog_out_1_current(self) -> float:
        """Current of analog out 1, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_analog_in_0_voltage(self) -> float:
        """Voltage of tool analog in 0, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_analog_in_0_current(self) -> float:
        """Current of tool analog in 0, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_analog_in_1_voltage(self) -> float:
        """Voltage of tool analog in 1, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_analog_in_1_current(self) -> float:
        """Current of tool analog in 1, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def robot_mode(self) -> str:
        """Mode of the arm: POWER_OFF, IDLE, RUNNING, .

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def safety_mode(self) -> str:
        """Mode of the safety system: NORMAL, .

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def program(self) -> str:
        """Mode of any program: STOPPED, PLAYING, PAUSED, .

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def protective_stop(self) -> bool:
        """Whether the safety system reports: protective stop.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def safeguard_stop(self) -> bool:
        """Whether the safety system reports: safeguard stop.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def emergency_stop(self) -> bool:
        """Whether the safety system reports: emergency stop.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def robot_emergency_stop(self) -> bool:
        """Whether the safety system reports: robot emergency stop.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def system_emergency_stop(self) -> bool:
        """Whether the safety system reports: system emergency stop.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def safety_violation(self) -> bool:
        """Whether the safety system reports: safety violation.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def safety_fault(self) -> bool:
        """Whether the safety system reports: safety fault.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def speed_slider(self) -> float:
        """Of the speed slider, 0 to 1.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def speed_scaling(self) -> float:
        """Share of its speed at which the program runs, 0 to 1.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def payload_mass(self) -> float:
        """Of the payload, kg.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_voltage(self) -> float:
        """Supply of the tool connector, V.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def tool_current(self) -> float:
        """That the tool takes, A.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def payload(self) -> tuple[float, ...]:
        """Mass, kg, and centre of gravity, m.

        Returns:
            tuple[float, ...]: numbers.

        Raises:
            DataTimeout: it is not known now.
        """

    def tcp(self) -> Pose:
        """Tool centre point, from the flange.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w.

        Raises:
            DataTimeout: it is not known now.
        """

    def program_running(self) -> bool:
        """Whether a program runs, the driver's own included.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def remote_control(self) -> bool:
        """Whether it is in remote control.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def loaded_program(self) -> str:
        """Which program is loaded; empty if none is.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

class Ur(LocalFront, Arm):
    """Universal Robots arms: UR3/5/10 (CB3), UR3e/5e/10e/16e, UR20, UR30."""

    @property
    def state(self) -> UrState:
        """What the device tells beyond CRTK."""

    def unlock_protective_stop(self, timeout: float = 30.0) -> str:
        """Leave a protective stop, 5 s after it at the earliest.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def restart_safety(self, timeout: float = 30.0) -> str:
        """Restart the safety system after a violation or fault; the arm loses its power.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def power_on(self, timeout: float = 30.0) -> str:
        """Power the arm, with its brakes engaged.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def brake_release(self, timeout: float = 30.0) -> str:
        """Power the arm and release its brakes.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def power_off(self, timeout: float = 30.0) -> str:
        """Switch the power of the arm off.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def close_popup(self, timeout: float = 30.0) -> str:
        """Close the pop-up on the teach pendant.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def close_safety_popup(self, timeout: float = 30.0) -> str:
        """Close the safety pop-up on the teach pendant.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def play_program(self, timeout: float = 30.0) -> str:
        """Start the loaded program, or go on with it where it was paused; it may move the arm.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def pause_program(self, timeout: float = 30.0) -> str:
        """Pause the program that runs.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def stop_program(self, timeout: float = 30.0) -> str:
        """Stop the program.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def shut_down(self, timeout: float = 30.0) -> str:
        """Shut the controller down.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def save_log(self, timeout: float = 30.0) -> str:
        """Save the log of the controller.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def zero_force_sensor(self, timeout: float = 30.0) -> str:
        """Make the present load zero, in the arm's force sensor.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def robot_mode(self, timeout: float = 30.0) -> str:
        """Tell the robot mode.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def safety_mode(self, timeout: float = 30.0) -> str:
        """Tell the safety mode.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def program_state(self, timeout: float = 30.0) -> str:
        """Tell the state and name of the program.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def loaded_program(self, timeout: float = 30.0) -> str:
        """Tell which program is loaded.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def operational_mode(self, timeout: float = 30.0) -> str:
        """Tell the operational mode.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def polyscope_version(self, timeout: float = 30.0) -> str:
        """Tell the version of the software.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def robot_model(self, timeout: float = 30.0) -> str:
        """Tell the model.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def serial_number(self, timeout: float = 30.0) -> str:
        """Tell the serial number.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def speed_slider(self, value: float, /) -> None:
        """Share of their speed at which programs run, 0 to 1.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def tool_voltage(self, value: float, /) -> None:
        """Supply voltage of the tool connector: 0, 12 or 24 V.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_0(self, value: bool, /) -> None:
        """Standard digital output 0.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_1(self, value: bool, /) -> None:
        """Standard digital output 1.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_2(self, value: bool, /) -> None:
        """Standard digital output 2.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_3(self, value: bool, /) -> None:
        """Standard digital output 3.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_4(self, value: bool, /) -> None:
        """Standard digital output 4.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_5(self, value: bool, /) -> None:
        """Standard digital output 5.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_6(self, value: bool, /) -> None:
        """Standard digital output 6.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def digital_out_7(self, value: bool, /) -> None:
        """Standard digital output 7.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_0(self, value: bool, /) -> None:
        """Configurable digital output 0.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_1(self, value: bool, /) -> None:
        """Configurable digital output 1.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_2(self, value: bool, /) -> None:
        """Configurable digital output 2.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_3(self, value: bool, /) -> None:
        """Configurable digital output 3.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_4(self, value: bool, /) -> None:
        """Configurable digital output 4.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_5(self, value: bool, /) -> None:
        """Configurable digital output 5.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_6(self, value: bool, /) -> None:
        """Configurable digital output 6.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def configurable_out_7(self, value: bool, /) -> None:
        """Configurable digital output 7.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def tool_out_0(self, value: bool, /) -> None:
        """Tool digital output 0.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def tool_out_1(self, value: bool, /) -> None:
        """Tool digital output 1.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def analog_out_0_voltage(self, value: float, /) -> None:
        """Voltage of analog output 0, 0 to 10 V.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def analog_out_1_voltage(self, value: float, /) -> None:
        """Voltage of analog output 1, 0 to 10 V.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def analog_out_0_current(self, value: float, /) -> None:
        """Current of analog output 0, 0.004 to 0.02 A.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def analog_out_1_current(self, value: float, /) -> None:
        """Current of analog output 1, 0.004 to 0.02 A.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def load_program(self, value: str, /) -> None:
        """Program to be loaded, by its path within the folder of programs.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def load_installation(self, value: str, /) -> None:
        """Installation to be loaded, by its path.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def popup(self, value: str, /) -> None:
        """What the teach pendant is to show.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def add_to_log(self, value: str, /) -> None:
        """Line for the log of the controller.

        Args:
            value: a text.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def payload_mass(self, value: float, /) -> None:
        """Mass of the payload, in kg.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def payload(self, value: ArrayLike, /) -> None:
        """Payload: mass, kg; centre of gravity from the flange, m (3); inertia about it: xx, yy, zz,
        xy, xz, yz, kg m² (6).

        Args:
            value: numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def tcp(self, value: PoseLike, /) -> None:
        """Tool centre point, from the flange.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def gravity(self, value: ArrayLike, /) -> None:
        """Acceleration opposite to gravity in base axes, m/s² (3).

        Args:
            value: numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_limits(self, value: ArrayLike, /) -> None:
        """With which the tool gives way in force mode at most, m/s and rad/s (2).

        Args:
            value: numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_damping(self, value: float, /) -> None:
        """Of force mode: 0 goes on when the force ends, 1 stops.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_gain(self, value: float, /) -> None:
        """Of the controller's own loop in force mode.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_of_tool(self, value: bool, /) -> None:
        """Whether the axes along which `free` lets the arm go are those of the tool.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_x(self, value: bool, /) -> None:
        """Whether `free` lets the arm go along x.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_y(self, value: bool, /) -> None:
        """Whether `free` lets the arm go along y.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_z(self, value: bool, /) -> None:
        """Whether `free` lets the arm go along z.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_rx(self, value: bool, /) -> None:
        """Whether `free` lets the arm go about x.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_ry(self, value: bool, /) -> None:
        """Whether `free` lets the arm go about y.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def free_axis_rz(self, value: bool, /) -> None:
        """Whether `free` lets the arm go about z.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_of_tool(self, value: bool, /) -> None:
        """Whether the axes along which the arm gives way to servo_cf are those of the tool.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_x(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf along x.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_y(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf along y.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_z(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf along z.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_rx(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf about x.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_ry(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf about y.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def force_axis_rz(self, value: bool, /) -> None:
        """Whether the arm gives way to servo_cf about z.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class Virtual(LocalFront, Arm):
    """An arm with dynamics in this process, without hardware: every CRTK command, walls to touch."""

    def apply_wrench(self, value: WrenchLike, /) -> None:
        """A hand that pushes: the wrench that acts on the tool from now on, in base axes.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

class WeissWsgState(Protocol):
    """What the device tells beyond CRTK."""

    def holds(self) -> bool:
        """Whether it holds something.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

    def grip(self) -> str:
        """What it does.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def fault(self) -> str:
        """What it reports; empty: nothing.

        Returns:
            str: a text.

        Raises:
            DataTimeout: it is not known now.
        """

    def force(self) -> float:
        """Of the fingers, in N.

        Returns:
            float: a number.

        Raises:
            DataTimeout: it is not known now.
        """

    def referenced(self) -> bool:
        """Whether it knows its opening.

        Returns:
            bool: True or False.

        Raises:
            DataTimeout: it is not known now.
        """

class WeissWsg(LocalFront, Gripper):
    """Weiss Robotics (SCHUNK) WSG grippers: WSG 50, WSG 32; TCP (binary or text), serial."""

    @property
    def state(self) -> WeissWsgState:
        """What the device tells beyond CRTK."""

    def grip(self, timeout: float = 30.0) -> str:
        """Grip a part of part_width with force, and watch over it.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def release(self, timeout: float = 30.0) -> str:
        """Let a part go, by release_by.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def reference(self, timeout: float = 30.0) -> str:
        """Find its reference, for which it moves to an end of its stroke and drops what it holds.

        Args:
            timeout: how long to wait for the answer, in s.

        Returns:
            str: the answer of the device, in words.

        Raises:
            CommandRefused: it cannot be carried out now; the error says why.
            DataTimeout: it has not ended in `timeout` s; it goes on all the same.
            TransitionFailed: a stop broke it off, or it did not end in the time that the device has
                for it.
            ConnectionLost: the link to the device was lost meanwhile.
            CrtkError: what the device says of why it failed.
        """

    def force(self, value: float, /) -> None:
        """Force of the next grip, in N.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

    def part_width(self, value: float, /) -> None:
        """Width in m of what the next grip is to find.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
        """

@overload
def connect(
    device: Literal["ati-netft"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> AtiNetft: ...
@overload
def connect(
    device: Literal["canopen"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Canopen: ...
@overload
def connect(
    device: Literal["copley"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Copley: ...
@overload
def connect(
    device: Literal["dvrk"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Dvrk: ...
@overload
def connect(
    device: Literal["dynamixel"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Dynamixel: ...
@overload
def connect(
    device: Literal["force-dimension"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> ForceDimension: ...
@overload
def connect(
    device: Literal["galil"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Galil: ...
@overload
def connect(
    device: Literal["haply"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Haply: ...
@overload
def connect(
    device: Literal["inputs"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Inputs: ...
@overload
def connect(
    device: Literal["loopback"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Loopback: ...
@overload
def connect(
    device: Literal["ndi"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Ndi: ...
@overload
def connect(
    device: Literal["onrobot"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Onrobot: ...
@overload
def connect(
    device: Literal["openhaptics"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Openhaptics: ...
@overload
def connect(
    device: Literal["optoforce"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Optoforce: ...
@overload
def connect(
    device: Literal["raven"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Raven: ...
@overload
def connect(
    device: Literal["robotiq"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Robotiq: ...
@overload
def connect(
    device: Literal["robotiq-epick"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> RobotiqEpick: ...
@overload
def connect(
    device: Literal["robotiq-ft300"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> RobotiqFt300: ...
@overload
def connect(
    device: Literal["ros2-control"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Ros2Control: ...
@overload
def connect(
    device: Literal["schunk"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Schunk: ...
@overload
def connect(
    device: Literal["schunk-fts"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> SchunkFts: ...
@overload
def connect(
    device: Literal["ur"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Ur: ...
@overload
def connect(
    device: Literal["virtual"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> Virtual: ...
@overload
def connect(
    device: Literal["weiss-wsg"],
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> WeissWsg: ...
@overload
def connect(
    device: str,
    *,
    sim: bool = False,
    config: Mapping[str, Any] | str | Path | None = None,
    timeout: float | None = None,
    sim_options: Mapping[str, Any] | None = None,
    **values: Any,
) -> LocalDevice:
    """Bring a device up in this process and return it connected. ROS is neither needed nor imported.

    Args:
        device: the name of a plugin: ``ur``, ...
        sim: start a simulator and connect to that.
        config: a configuration, or the path of a TOML or YAML file.
        timeout: seconds to wait for the connection; None: `open_timeout` where the configuration gives it,
            else 10.
        sim_options: for the simulator.
        values: single configuration values, over `config`: ``host="192.168.1.10"``.

    Raises:
        PluginError, MissingExtra, ConfigError: it cannot be started as asked.
        ConnectionFailed: not connected in time; everything is closed again.
    """
