"""A Universal Robots arm as a CRTK device.

Two ways lead to the controller. The state comes over an RTDE connection of our own (`rtde.stream`), read
in the I/O thread. Commands go over a `ControlLink`: to a control program of our own (`native`), or to a
control process that owns the vendor library (`library`), which may hang or crash without harm to this
one. In both the controller's watchdog stops the arm when nothing is heard of them.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any, Final

from typing_extensions import override

from crtk_driver_ur.abilities import capabilities_of
from crtk_driver_ur.arm_geometry import ArmGeometry
from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.control_link import PROGRAM_STOPPED, ControlLink
from crtk_driver_ur.control_options import ControlOptions, MotionOptions
from crtk_driver_ur.inputs import UrInputs
from crtk_driver_ur.io_settings import output_settings
from crtk_driver_ur.models import CB3, RobotModel
from crtk_driver_ur.program_settings import AT_REST, ProgramSettings
from crtk_driver_ur.readings import UrReadings
from crtk_driver_ur.reports import numbers_of, reports_of
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.robot_api import POLYSCOPE_X, REMOTE_SINCE
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.stream import RTDE_PORT, RtdeStream
from crtk_driver_ur.safety import (
    PAUSED_PROGRAM,
    PROGRAM_PAUSED,
    STANDING_PROGRAM,
    found_in,
    stood,
)
from crtk_driver_ur.services import UrServices
from crtk_driver_ur.servo_lag import ServoLag
from crtk_driver_ur.tool_line import ToolLine
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Goal,
    Input,
    Kinematics,
    Mode,
    MoveProgress,
    Note,
    Reading,
    Service,
    Setpoint,
    Severity,
    Steps,
)
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    CrtkError,
    DeviceError,
    MotionAborted,
    Reason,
    TransitionFailed,
    raise_first,
)
from crtk_drivers.geometry.quaternions import rotvec_from_pose
from crtk_drivers.samples import Sample
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

STOP_TIMEOUT = 5.0
"""Seconds that disable waits for the arm to stand, before it goes on to switch the power off."""

FIRST_STATE = 0.5
"""Seconds at least for the first state of a connection."""

DEAD_AFTER = 0.1
"""Seconds without a sample after which the controller counts as silent."""

LATE_AFTER = 0.02
"""Seconds: a state that may be older than this when it comes is not valid, and a note says so."""

LATE_PERIODS = 5.0
"""The same in periods of the states, where they come seldom."""

LATE_FOR = 1.0
"""Seconds in which one that comes in time must follow for the arm to be enabled: who was held up once is."""

OTHER_PROGRAM_TIMEOUT = 1.0
"""Seconds in which a program that is not ours must end: the watchdog ends one of a driver that died."""

REMOTE_CONTROL_SINCE = (5, 6)
"""PolyScope version from which on there is remote and local control (Dashboard Server manual)."""

_LINKS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "native": "crtk_driver_ur.native.link:NativeLink",
        "ur_rtde": "crtk_driver_ur.library.link:ProcessLink",
    }
)
"""The link of each `control`, imported when it is asked for: neither needs the other to be there."""

_PROGRAM_STOPPED = Condition(
    OperatingState.PAUSED,
    "the control program was stopped on the controller (teach pendant, or its watchdog). "
    "Look at the teach pendant, then resume.",
)


class UrDevice(Device):
    """One arm.

    Args:
        config: see `UrConfig`.
        gripper: that hangs at its tool, with a bus of its own.
        its_line: keys of `tool_line` that the gripper wants otherwise than they are by default.
    """

    def __init__(
        self,
        config: UrConfig,
        gripper: Device | None = None,
        its_line: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self._config = config
        self._model: RobotModel = config.arm
        self._tool_line = ToolLine(
            config.tool_line,
            gripper,
            config.host,
            its_line,
            has_line=self._model.generation is not CB3,
        )
        hung = self._tool_line.device
        self._children: dict[str, Device] = {}
        if hung is not None and config.gripper is not None:
            self._children[config.gripper.name] = hung
        self._geometry = ArmGeometry(config, self._model, f"ur {self.address}")
        link = resolve_name(_LINKS[config.control])
        options = _control_options(config, self._model)
        self._link: ControlLink = link(config.host, options, f"ur {self.address}")
        self._stream: RtdeStream | None = None
        self._opening: RtdeStream | None = None
        self._aborted = False
        self._stream_lost = False
        self._robot = Robot(
            self._link, f"ur {self.address}", needs_remote=config.require_remote_control
        )
        self._lag = ServoLag()
        self._in_control = False
        self._has_program = False  # what runs on the controller, or is about to, is ours
        self._starting = False
        self._why_stopped = _PROGRAM_STOPPED
        self._found = ""
        self._services = UrServices(
            self._robot, self._link, self._model, self._controls, f"ur {self.address}"
        )
        self._settings = ProgramSettings(self._robot, config, self._geometry.use_tool)
        self._inputs = UrInputs(
            self._robot,
            self._link,
            (*output_settings(), *self._settings.settings()),
            self._settings.keep,
            self._controls,
            f"ur {self.address}",
        )
        self._readings = UrReadings(self._robot, self._link)
        self._goal: Goal | None = None  # of a move that waits for the controller to have its tool

    # ------------------------------------------------------------------------------------ description

    @property
    @override
    def capabilities(self) -> Capabilities:
        return capabilities_of(self._config, self._model)

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host or '(no host)'}:{RTDE_PORT}"

    @property
    @override
    def has_stopped(self) -> bool:
        """The program says so, or none of ours runs; and the controller aims at rest."""
        return self._robot.standing and not self._link.stopping

    @property
    @override
    def found(self) -> str:
        return self._found

    @property
    @override
    def takes_setpoints(self) -> bool:
        return not (self._link.stopping or self._is_changing)

    @property
    @override
    def pace(self) -> float:
        """By the speed slider, and what the controller itself slows down."""
        state = self._robot.state
        return 1.0 if state is None else state.combined_speed_scaling

    @property
    @override
    def has_arrived(self) -> bool:
        """ServoJ smooths, and is late by its lookahead."""
        state = self._robot.state
        if state is None:
            return True
        # An arm that is held up by the speed slider stands as well.
        return self.pace > 0.0 and self._robot.standing and self._lag.has_ended(state.target_q)

    @property
    def _is_changing(self) -> bool:
        """Whether the controller is about to have another tool, payload or gravity."""
        return self._in_control and any(map(self._inputs.is_changing, AT_REST))

    @property
    @override
    def condition(self) -> Condition:
        found = self._robot.condition
        if found.allows is not OperatingState.ENABLED or not self._in_control:
            return found
        if self._link.loss:
            return Condition(OperatingState.FAULT, self._link.loss)
        if self._link.program_runs:
            return found
        if self._link.complaint:
            said = f"{self._why_stopped.reason} The controller says: {self._link.complaint}."
            return Condition(self._why_stopped.allows, said)
        return self._why_stopped

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        """Of the RTDE stream (packages) and of whoever carries commands out."""
        state, stream = self._robot.state, self._stream
        counters = {
            **self._link.counters,
            "servo lag (s)": self._lag.seconds,
            "state age (s)": self._age,
        }
        if stream is not None:
            packages = stream.counters
            counters["packages lost"] = float(packages.lost)
            counters["packages skipped"] = float(packages.skipped)
            counters["packages malformed"] = float(packages.malformed)
        if state is not None:
            counters["robot mode"] = float(state.robot_mode)
            counters["safety mode"] = float(state.safety_mode)
            counters |= numbers_of(state)
        return counters

    @property
    @override
    def kinematics(self) -> Kinematics:
        return self._geometry.kinematics

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return self._services.table

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return self._inputs.table

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        return self._readings.table

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return self._children

    @property
    @override
    def followers(self) -> frozenset[str]:
        hung = self._config.gripper
        return frozenset() if hung is None or hung.own_state else frozenset(self._children)

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        state, stream = self._robot.state, self._stream
        reports = () if state is None else reports_of(state)
        nonsense = "" if stream is None else stream.nonsense
        if nonsense:
            text = f"the controller sends {nonsense} as no finite number; samples are dropped"
            reports = (Note(Severity.ERROR, "samples", text), *reports)
        if late := self._late:
            reports = (Note(Severity.ERROR, "samples", _states_late(late)), *reports)
        note = self._geometry.note
        calibration = (*((note,) if note else ()), *self._geometry.limit_notes)
        waiting = () if self._controls() else self._settings.waiting()
        return (*self._inputs.notes(), *waiting, *calibration, *reports)

    @property
    def robot_state(self) -> StateSample | None:
        """The controller's newest state, with everything that it reports; None while not connected."""
        return self._robot.state

    @property
    def _age(self) -> float:
        """How old the newest state may have been when it came, s; 0 where that is not known.

        By what answers on its own connection, and by what the control program has seen: the less is true.
        """
        stream, state = self._stream, self._robot.state
        by_stream = 0.0 if stream is None or state is None else stream.age(state)
        return min((age for age in (by_stream, self._link.lateness) if age > 0.0), default=0.0)

    @property
    def _late(self) -> float:
        """How old the newest state may have been when it came, s; 0 as long as that is as usual."""
        stream, late = self._stream, self._age
        periods = 0.0 if stream is None else LATE_PERIODS / stream.frequency
        return late if late > max(LATE_AFTER, periods) else 0.0

    def _controls(self) -> bool:
        return self._in_control and self._link.program_runs

    # ------------------------------------------------------------------------------------- connection

    @override
    def open(self, deadline: float) -> None:
        config = self._config
        sees_all = config.control == "ur_rtde"
        stream = RtdeStream(config.host, frequency=config.frequency, sees_all=sees_all)
        self._opening = stream
        if self._aborted:
            stream.close()
        try:
            stream.open(deadline)
            self._check_generation(stream)
            version = (stream.controller_version.major, stream.controller_version.minor)
            self._link.open(version, has_local_control=_tells_who_has_control(version))
            if not self._aborted:
                self._geometry.learn_calibration(deadline)
            if not self._aborted:
                self._tool_line.switch_on(f"ur {self.address}")
            self._found = found_in(stream.receive(max(deadline, time.monotonic() + FIRST_STATE)))
        except BaseException:
            stream.close()
            raise
        finally:
            self._opening = None
        self._stream, self._stream_lost = stream, False
        self._robot.state, self._in_control = None, False
        self._inputs.reset()

    @override
    def abort_open(self) -> None:
        self._aborted = True
        opening = self._opening
        if opening is not None:
            opening.close()

    def _check_generation(self, stream: RtdeStream) -> None:
        cb3_controller = stream.controller_version.major < 5
        if cb3_controller is not (self._model.generation is CB3):
            kind = "a CB3" if cb3_controller else "an e-Series"
            raise ConnectionFailed(
                f"PolyScope {stream.controller_version} is {kind} controller, "
                f"but model is {self._model.name}",
                where=f"ur {self.address}",
                remedy="Set `model` to the arm that is connected.",
            )

    @override
    def close(self) -> None:
        stream, self._stream = self._stream, None
        lost = self._stream_lost or stream is None or self._is_silent(stream)
        has_program, self._has_program = self._has_program, False
        has_power = self._in_control or has_program
        try:
            self._link.close(lost=lost)
            if stream is not None and has_program and not lost:
                self._end_program_now(stream)
        finally:
            if stream is not None:
                stream.close()
            self._robot.state, self._in_control = None, False
        if has_power and not lost and self._config.on_close == "power_off":
            self._link.request_now("power_off")

    def _is_silent(self, stream: RtdeStream) -> bool:
        """Whether the controller tells nothing; where this thread was held up, what came meanwhile counts."""
        state = self._robot.state
        if state is None:
            return True
        if time.monotonic() - state.received <= DEAD_AFTER:
            return False
        try:
            return stream.receive(time.monotonic() + DEAD_AFTER) is None
        except DeviceError:
            return True

    def _end_program_now(self, stream: RtdeStream) -> None:
        """See that our program has ended, or have the dashboard end it.

        A paused one takes no command and no watchdog ends it: somebody could continue it at any time.
        """
        deadline = time.monotonic() + OTHER_PROGRAM_TIMEOUT
        with suppress(ConnectionLost):
            while time.monotonic() < deadline:
                state = stream.receive(deadline)
                if state is None:
                    continue
                if state.runtime_state in PAUSED_PROGRAM:
                    break
                if state.runtime_state in STANDING_PROGRAM:
                    return
        self._link.request_now("stop_program")

    @override
    def wake(self) -> bool:
        stream = self._stream
        return stream is not None and stream.wake()

    @override
    def read(self, deadline: float) -> Sample | None:
        if self._stream is None:
            raise ConnectionLost("not open", where=f"ur {self.address}")
        self._link.follow()
        try:
            state = self._stream.receive(deadline)
        except DeviceError:
            self._stream_lost = True
            raise
        if state is None:
            return None
        self._robot.take(state)
        self._link.take(state)
        self._lag.measure(state.actual_q, state.actual_qd)
        over = self._link.replaced or stood(state)
        self._has_program = self._has_program and (self._starting or not over)
        if self._has_program and self._robot.paused:
            self._link.end_paused_program()
            self._why_stopped = PROGRAM_PAUSED
        self._geometry.follow_tool(state)
        self._inputs.step()
        return self._geometry.samples.make(state, self._age)

    # ----------------------------------------------------------------------------------------- motion

    @override
    def write(self, setpoint: Setpoint) -> None:
        servo, link, valid_for = self._config.servo, self._link, self._config.stream_timeout
        self._goal = None
        values = setpoint.values.tolist()
        if setpoint.mode is Mode.JOINT_POSITION:
            link.servo_joint(values)
            self._lag.command(values)
            return
        self._lag.end()
        if setpoint.mode is Mode.JOINT_VELOCITY:
            link.speed_joint(values, servo.joint_acceleration, valid_for)
        elif setpoint.mode is Mode.CARTESIAN_EFFORT:
            link.force(values)
        else:
            link.speed_cartesian(values, servo.linear_acceleration, valid_for)

    @override
    def stop(self) -> None:
        self._lag.end()
        self._goal = None
        self._link.stop()

    @override
    def move(self, goal: Goal) -> None:
        self._lag.end()
        if self._is_changing:
            self._goal = goal
        else:
            self._begin_move(goal)

    def _begin_move(self, goal: Goal) -> None:
        move, link = self._config.move, self._link
        if goal.joints is not None:
            link.move_joint(
                goal.joints.tolist(),
                move.joint_velocity * goal.ratios.velocity,
                move.joint_acceleration * goal.ratios.acceleration,
            )
            return
        assert goal.pose is not None
        if not self._geometry.samples.has_tool_of_controller:
            raise MotionAborted(
                "the controller has another tool centre point than the driver",
                where=f"ur {self.address}",
                remedy="Send tcp again, or disable and enable.",
            )
        link.move_linear(
            rotvec_from_pose(goal.pose).tolist(),
            move.linear_velocity * goal.ratios.velocity,
            move.linear_acceleration * goal.ratios.acceleration,
        )

    @override
    def move_progress(self) -> MoveProgress:
        goal = self._goal
        if goal is not None:
            if not self._is_changing:
                self._goal = None
                self._begin_move(goal)
            return MoveProgress.RUNNING
        progress = self._link.move_progress()
        # What says so came over a connection without a checksum; the arm must stand as well.
        moving = progress is MoveProgress.DONE and not self._robot.standing
        return MoveProgress.RUNNING if moving else progress

    @override
    def free(self) -> Steps:
        self._goal = None
        yield from self._robot.until(lambda: not self._is_changing)  # it would sink, or rise
        self._link.freedrive()
        while True:
            self._link.move_progress()
            yield

    # ------------------------------------------------------------------------------------- transitions

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if self._in_control or self._robot.state is None:
            return ()
        may_run = self._has_program or self._link.left_program
        return (
            *self._robot.obstacles("enable", unlocks=self._config.enable_unlocks),
            *self._geometry.misfits(self._robot.state),
            *(() if may_run else self._other_program("enable")),
            *self._old_states("enable"),
        )

    @override
    def enable(self) -> Steps:
        """Power on, release the brakes, start the control program; unlock a protective stop if configured."""
        with self._robot.claimed():
            yield from self._begin("enable")
            if self._config.enable_unlocks:
                yield from self._robot.unlock()
            raise_first(self._robot.obstacles("enable"))
            raise_first(self._geometry.misfits(self._robot.state))
            yield from self._robot.release_brakes()
            raise_first(self._geometry.misfits(self._robot.state))
            yield from self._start_program("enable")

    @override
    def resume(self) -> Steps:
        """Take control again; the setpoint starts from where the arm is now."""
        with self._robot.claimed():
            yield from self._begin("resume")
            raise_first(self._robot.obstacles("resume"))
            yield from self._start_program("resume")

    @override
    def pause(self) -> Steps:
        """Stop and keep the control program and the power."""
        self.stop()
        yield from self._robot.until(lambda: self._robot.standing)
        self._in_control = False

    @override
    def disable(self) -> Steps:
        """Stop, end the control program, and switch the power off (if configured)."""
        self._in_control = False
        if self._link.program_runs:
            self.stop()
            yield from self._robot.until(lambda: self._robot.standing, STOP_TIMEOUT)
            yield from self._link.stop_program()
        if self._config.power_off_on_disable and self._robot.has_power:
            self._link.give_up_connecting()
            yield from self._robot.power_off()

    def _begin(self, command: str) -> Steps:
        """Forget what took control away, and see that it can be had again."""
        self._in_control, self._link.loss = False, ""
        self._link.arm = self._geometry.arm
        yield from self._robot.until(lambda: self._robot.state is not None and self._link.ready)
        yield from self._robot.require_remote("state_command", f"{command}: ")
        yield from self._robot.until(lambda: not self._robot.paused, OTHER_PROGRAM_TIMEOUT)

    def _start_program(self, command: str) -> Steps:
        if not (self._link.connected and self._link.program_runs):
            yield from self._require_no_program(command)
            self._has_program = self._starting = True
            try:
                yield from self._link.start_program()
            finally:
                self._starting = False
        yield from self._configure()
        yield from self._robot.until(
            lambda: self._robot.playing or not self._has_program, safe=True
        )
        yield from self._robot.until(
            lambda: not (self._late and self._has_program), LATE_FOR, safe=True
        )
        if not self._has_program:
            raise TransitionFailed(
                f"{command}: {PROGRAM_STOPPED}",
                where=f"ur {self.address}",
                remedy="Look at the teach pendant, then send it again.",
            )
        raise_first(self._old_states(command))
        self._link.program_runs = self._in_control = True
        self._why_stopped = _PROGRAM_STOPPED

    def _require_no_program(self, command: str) -> Steps:
        """Leave a program alone that somebody else runs, for it may be moving the arm."""
        yield from self._robot.until(lambda: not self._robot.playing, OTHER_PROGRAM_TIMEOUT)
        if self._robot.playing and self._link.left_program:
            yield from self._link.end_left_program()
            yield from self._robot.until(lambda: not self._robot.playing, OTHER_PROGRAM_TIMEOUT)
        raise_first(self._other_program(command))

    def _other_program(self, command: str) -> Iterator[CommandRefused]:
        """Yield that the controller runs a program which is not ours, and which we may not end."""
        if self._robot.playing:
            yield CommandRefused(
                "state_command",
                Reason.LOCAL_CONTROL,
                f"{command}: the controller is running another program",
                where=f"ur {self.address}",
                remedy="Stop that program, then send it again.",
            )

    def _old_states(self, command: str) -> Iterator[TransitionFailed]:
        """Yield that states of the controller come too late to be acted on."""
        if self._late:
            yield TransitionFailed(
                f"{command}: {_states_late(self._late)}",
                where=f"ur {self.address}",
                remedy="Look at the network: something between holds packages back (a gateway, Wi-Fi, a "
                "busy switch).",
            )

    def _configure(self) -> Steps:
        """Tell the control program what it does not keep."""
        for name, arguments in self._settings.requests():
            yield from self._link.ask(name, **arguments)


def _states_late(late: float) -> str:
    return f"states of the controller may be {late:.2f} s old when they come"


def _tells_who_has_control(version: tuple[int, int]) -> bool:
    return version >= (REMOTE_CONTROL_SINCE if version < POLYSCOPE_X else REMOTE_SINCE)


def _control_options(config: UrConfig, model: RobotModel) -> ControlOptions:
    return ControlOptions(
        watchdog_frequency=config.watchdog_frequency,
        upper_range_registers=config.upper_range_registers,
        require_remote_control=config.require_remote_control,
        robot_api_port=config.robot_api_port,
        joint_acceleration=max(config.servo.joint_acceleration, config.move.joint_acceleration),
        motion=MotionOptions(
            period=1.0 / model.frequency,
            lookahead=config.servo.lookahead,
            gain=config.servo.gain,
            joint_deceleration=config.servo.joint_acceleration,
            linear_deceleration=config.servo.linear_acceleration,
            joint_speeds=model.velocity_limits,
        ),
    )
