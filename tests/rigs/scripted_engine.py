"""An engine on a device that does what a test says, and a clock that the test turns."""

from collections.abc import Callable, Mapping
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Condition,
    Device,
    Goal,
    JointLimits,
    Kinematics,
    Mode,
    MoveProgress,
    Setpoint,
    Steps,
)
from crtk_drivers.engine import Engine, EngineOptions, Observer
from crtk_drivers.errors import CommandRefused, ConnectionFailed, KinematicsError
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, rotvec_from_quaternion
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, Vector, vector
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.testing.clock import FakeClock

JOINTS = ("slide", "turn")
LIMIT = JointLimits(-1.0, 1.0, velocity=1.0, acceleration=10.0, jerk=100.0, effort=5.0)
RATE = 100.0
PERIOD = 1.0 / RATE


def two_joints(**changes: Any) -> Capabilities:
    values: dict[str, Any] = {
        "joints": JOINTS,
        "limits": (LIMIT, LIMIT),
        "cartesian_limits": CartesianLimits(0.5, 1.0, 5.0, 5.0, force=10.0, torque=2.0),
        "modes": frozenset(
            {
                Mode.JOINT_POSITION,
                Mode.JOINT_VELOCITY,
                Mode.JOINT_EFFORT,
                Mode.CARTESIAN_VELOCITY,
                Mode.CARTESIAN_EFFORT,
            }
        ),
        "measured": ("measured_js", "measured_cp"),
        "has_free": True,
        "rate": RATE,
        "transition_timeout": 1.0,
    }
    return Capabilities(**(values | changes))


class SlideAndTurn(Kinematics):
    """A tool that slides along x and turns about z."""

    def forward(self, joints: Vector) -> Pose:
        if joints.size != 2:
            return Pose(vector((0, 0, 0)), vector((0, 0, 0, 1)), "base")
        x, angle = joints.tolist()
        turn = quaternion_from_rotvec(vector((0.0, 0.0, angle)))
        return Pose(vector((x, 0.0, 0.0)), turn, "base")

    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        if abs(pose.position[1]) > 1e-9:
            raise KinematicsError("y is out of reach", remedy="Keep y at 0.")
        return vector((pose.position[0], rotvec_from_quaternion(pose.orientation)[2]))

    def jacobian(self, joints: Vector) -> Any:
        return np.eye(6)[:, [0, 5]]


class ScriptedDevice(Device):
    """Positions that are written are measured in the next cycle; `calls` records what was asked for.

    `fail` maps the name of a method to what it raises, `procedures` the name of a state command to
    what it does instead of ending at once. It measures poses by `solver`, which without
    `has_kinematics` nobody else has.
    """

    def __init__(
        self,
        clock: FakeClock,
        capabilities: Capabilities | None = None,
        has_kinematics: bool = True,
    ) -> None:
        self.clock = clock
        self.solver: Kinematics = SlideAndTurn()
        self.has_kinematics = has_kinematics
        self.declared = capabilities or two_joints()
        self.position = np.zeros(len(self.declared.joints))
        self.silent = False
        self.stamp: Stamp | None = None
        self.native_setpoint: JointState | None = None
        self.reported = Condition()
        self.homed = False
        self.progress = MoveProgress.RUNNING
        self.calls: list[str] = []
        self.written: list[Setpoint] = []
        self.goals: list[Goal] = []
        self.fail: dict[str, BaseException] = {}
        self.procedures: dict[str, Callable[[], Steps]] = {}

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if name in self.fail:
            raise self.fail[name]

    @property
    def capabilities(self) -> Capabilities:
        return self.declared

    @property
    def address(self) -> str:
        return "nowhere:1"

    @property
    def condition(self) -> Condition:
        return self.reported

    @property
    def is_homed(self) -> bool:
        return self.homed

    @property
    def kinematics(self) -> Kinematics | None:
        return self.solver if self.has_kinematics else None

    def open(self, deadline: float) -> None:
        self._called("open")

    def close(self) -> None:
        self._called("close")

    def read(self, deadline: float) -> Sample | None:
        if "read" in self.fail:
            raise self.fail["read"]
        if self.silent:
            return None
        joints = vector(self.position)
        values: dict[str, Any] = {
            "measured_js": JointState(position=joints, name=self.declared.joints),
        }
        if np.isfinite(joints).all():
            values["measured_cp"] = self.solver.forward(joints)
        if self.native_setpoint is not None:
            values["setpoint_js"] = self.native_setpoint
        return Sample(self.stamp or self.clock.stamp(), values)

    def write(self, setpoint: Setpoint) -> None:
        self._called("write")
        self.written.append(setpoint)
        if setpoint.mode is Mode.JOINT_POSITION:
            self.position = setpoint.values.copy()

    def stop(self) -> None:
        self._called("stop")

    def move(self, goal: Goal) -> None:
        self._called("move")
        self.goals.append(goal)

    def move_progress(self) -> MoveProgress:
        return self.progress

    def _procedure(self, name: str) -> Steps:
        self._called(name)
        if name in self.procedures:
            yield from self.procedures[name]()

    def enable(self) -> Steps:
        return self._procedure("enable")

    def disable(self) -> Steps:
        return self._procedure("disable")

    def pause(self) -> Steps:
        return self._procedure("pause")

    def resume(self) -> Steps:
        return self._procedure("resume")

    def home(self) -> Steps:
        yield from self._procedure("home")
        self.homed = True

    def unhome(self) -> Steps:
        yield from self._procedure("unhome")
        self.homed = False

    def free(self) -> Steps:
        return self._procedure("free")


class Recorder(Observer):
    """Everything that observers hear, in order."""

    def __init__(self) -> None:
        self.statuses: list[tuple[Status, Stamp]] = []
        self.refusals: list[CommandRefused] = []
        self.goals: list[str] = []
        self.warnings: list[str] = []

    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.statuses.append((status, stamp))

    def command_refused(self, refusal: CommandRefused) -> None:
        self.refusals.append(refusal)

    def latched(self, name: str) -> None:
        self.goals.append(name)

    def warned(self, text: str) -> None:
        self.warnings.append(text)

    @property
    def states(self) -> list[OperatingState]:
        return [status.state for status, _ in self.statuses]

    @property
    def busy(self) -> list[bool]:
        return [status.is_busy for status, _ in self.statuses]


LONG_STEPS = EngineOptions(limits=LimitPolicy(max_step=0.1))
"""A test has few commands; each may go further than is wise by default."""


class Rig:
    def __init__(
        self,
        options: EngineOptions | None = None,
        capabilities: Capabilities | None = None,
        has_kinematics: bool = True,
    ) -> None:
        self.clock = FakeClock()
        self.device = ScriptedDevice(self.clock, capabilities, has_kinematics)
        self.engine = Engine(
            self.device, "rig", options or LONG_STEPS, self.clock, self.clock.advance
        )
        self.told = Recorder()
        self.engine.add_observer(self.told)

    def wall_ns(self) -> int:
        """Return the time of its clock, in ns as stamps have it."""
        return self.clock.stamp().wall_ns

    def tells_time_to(self, module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have a module that asks what time it is, for the age of a stamp, told that of its clock."""
        monkeypatch.setattr(module, "time", SimpleNamespace(time_ns=self.wall_ns))

    @property
    def state(self) -> OperatingState:
        return self.engine.status.state

    @property
    def written(self) -> list[Setpoint]:
        return self.device.written

    def connect(self) -> "Rig":
        try:
            self.engine.connect(self.clock() + 1.0)
        except ConnectionFailed:
            return self
        self.cycle()
        return self

    def disconnect(self, reason: str, remedy: str = "") -> None:
        """As the I/O thread does it when the link is lost."""
        try:
            self.engine.lose(reason, remedy)
        finally:
            self.device.close()

    def cycle(self, count: int = 1, period: float = PERIOD) -> None:
        for _ in range(count):
            self.clock.advance(period)
            self.engine.cycle(self.clock() + period)

    def command(self, text: str) -> None:
        stands_first = self.state is OperatingState.ENABLED and text != "enable"
        self.engine.state_command(text)
        self.cycle(2 if stands_first else 1)

    def enabled(self) -> "Rig":
        if not self.engine.connected:
            self.connect()
        self.command("enable")
        assert self.state is OperatingState.ENABLED
        return self

    def servo(self, *position: float) -> None:
        self.engine.submit("servo_jp", jp(*position))

    def refused(self, name: str, value: Any = None, **arguments: Any) -> CommandRefused:
        before, writes = len(self.told.refusals), len(self.written)
        with pytest.raises(CommandRefused) as caught:
            self.engine.submit(name, value, **arguments)
        assert self.told.refusals[before:] == [caught.value]
        assert caught.value.where == self.engine.where
        self.cycle()
        assert len(self.written) == writes, "a refused command reached the device"
        return caught.value

    def value(self, name: str) -> tuple[Any, int]:
        found = self.engine.feedback(name)
        assert found is not None
        return found[0], found[1].wall_ns

    def setpoint(self) -> Mapping[str, list[float]]:
        state, _ = self.value("setpoint_js")
        fields = ("position", "velocity", "effort")
        return {name: getattr(state, name).tolist() for name in fields}


def jp(*values: float) -> JointState:
    return JointState(position=vector(values))


def jv(*values: float) -> JointState:
    return JointState(velocity=vector(values))


def jf(*values: float) -> JointState:
    return JointState(effort=vector(values))


def pose(x: float, angle: float = 0.0, y: float = 0.0, frame: str = "") -> Pose:
    turn = quaternion_from_rotvec(vector((0.0, 0.0, angle)))
    return Pose(vector((x, y, 0.0)), turn, frame)
