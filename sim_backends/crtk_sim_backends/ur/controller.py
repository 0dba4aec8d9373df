"""The simulated controller: one control period per `tick`, without sockets and without a clock."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.ur import variables
from crtk_sim_backends.ur.arm import Arm
from crtk_sim_backends.ur.compliance import Compliance
from crtk_sim_backends.ur.dynamics import Dynamics
from crtk_sim_backends.ur.force_sensor import ForceSensor
from crtk_sim_backends.ur.kinematics import IDENTITY, Floats, Kinematics, Matrix, to_transform
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    KeyMessage,
    Message,
    PopupMessage,
    ReportLevel,
    RuntimeExceptionMessage,
    SafetyModeMessage,
)
from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.motion import MotionLibrary
from crtk_sim_backends.ur.process_image import ProcessImage
from crtk_sim_backends.ur.program import ProgramRuntime
from crtk_sim_backends.ur.robot_library import CONTACT_FORCE, robot_builtins
from crtk_sim_backends.ur.safety import (
    POWER_OFF_SECONDS,
    POWER_UP,
    PROTECTIVE_STOP_LOCK_SECONDS,
    SAFETY_RULES,
    STOP_REASONS,
    ProgramRule,
    RobotMode,
    RuntimeState,
    SafetyMode,
    SafetyRule,
    gravest,
)
from crtk_sim_backends.ur.urscript import (
    PURE_BUILTINS,
    Builtin,
    ScriptError,
    compile_program,
    timing_builtins,
)

SCALE_SECONDS: Final = 0.2  # for speed scaling to go from nothing to full, s
IDLE_PROGRAM: Final = "def {}():\n  while (True):\n    sleep(0.1)\n  end\nend\n"
STORED_PROGRAMS: Final = ("external_control.urp", "simulation.urp")
OPERATIONAL_MODES: Final = ("NONE", "MANUAL", "AUTOMATIC")

_NOT_IN_REMOTE: Final = 210
_PLAYABLE: Final[tuple[RuntimeState, ...]] = (RuntimeState.STOPPED, RuntimeState.STOPPING)
_STEPPED: Final = (RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING)
_ACTIVE: Final = (*_STEPPED, RuntimeState.PAUSED)
_UNDER_POWER: Final = (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)

_log = logging.getLogger(__name__)


def no_builtins(controller: Controller) -> Iterable[Builtin]:
    """Add nothing to the built-ins of a controller."""
    return ()


@dataclass
class _Watchdog:
    period: float
    action: str
    kicked: float


class Controller:
    """One robot and its controller in virtual time. Not thread-safe: one thread drives it.

    Args:
        model: arm, from `models.MODELS`.
        version: software version (major, minor, bugfix, build).
        powered_on: start in RUNNING with the brakes released, else in POWER_OFF.
        remote: start in remote control.
        extra_builtins: URScript built-ins to add (the socket functions of `script_sockets`).

    Attributes:
        dt: control period, s: 1/500 (e-Series and later) or 1/125 (CB3).
        tick_count: periods since start.
        time: seconds since start; advances in `tick` alone.
        outputs: process image by RTDE output variable name, valid after each `tick`.
        inputs: the same by RTDE input variable name.
        operational_mode: "NONE", "MANUAL" or "AUTOMATIC".
        popup_text: text of the open pop-up, or None.
        programs: text of each stored program by file name.
        loaded_program: file name of the loaded program, "" when none.
        program_name: of the running or last program, "" before the first.
        program_ended: called when the running program ends, so that its sockets are closed.
    """

    def __init__(
        self,
        model: RobotModel,
        version: tuple[int, int, int, int],
        *,
        powered_on: bool = True,
        remote: bool = True,
        extra_builtins: Callable[[Controller], Iterable[Builtin]] = no_builtins,
    ) -> None:
        self.model = model
        self.version = version
        self.dt = 1.0 / model.frequency
        self.tick_count = 0
        self.time = 0.0
        self.outputs: dict[str, Any] = variables.initial_image(variables.OUTPUTS)
        self.inputs: dict[str, Any] = variables.initial_image(variables.INPUTS)
        self.remote: bool = remote
        self.operational_mode: str = "NONE"
        self.popup_text: str | None = None
        self.programs = {
            name: IDLE_PROGRAM.format(name.removesuffix(".urp")) for name in STORED_PROGRAMS
        }
        self.loaded_program: str = ""
        self.program_name = ""
        self.program_ended: Callable[[], None] | None = None

        self.robot_mode: RobotMode = RobotMode.POWER_OFF
        self.safety_mode: SafetyMode = SafetyMode.NORMAL
        self.runtime_state: RuntimeState = RuntimeState.STOPPED
        self.arm = Arm(model, self.dt)
        self.kinematics = Kinematics(model)
        self.dynamics = Dynamics(self.kinematics)
        self.compliance = Compliance(self.arm, self.kinematics)
        self.force_sensor = ForceSensor()
        self.tool = IDENTITY
        self.tcp: tuple[float, ...] = (0.0,) * 6
        self.payload = 0.0
        self.payload_cog: tuple[float, ...] = (0.0,) * 3
        self.payload_inertia: tuple[float, ...] = (0.0,) * 6
        self.gravity: tuple[float, ...] = (0.0, 0.0, 9.82)
        self.waypoint: Floats | None = None
        self.load_revision = 0

        self._messages: list[Message] = []
        self._causes: set[SafetyMode] = set()
        self._protective_stop_time = 0.0
        self._power_goal = RobotMode.POWER_OFF
        self._power_due = 0.0
        self._speed_slider = 1.0  # ramped towards target_speed_fraction
        self._pause_factor = 1.0
        self._contact_tick: int | None = None
        self._watchdogs: dict[str, _Watchdog] = {}
        self._program: ProgramRuntime | None = None
        self._secondary: list[ProgramRuntime] = []
        self.active_runtime: ProgramRuntime | None = None
        self._motion = MotionLibrary(self)
        self._builtins = {
            **PURE_BUILTINS,
            **timing_builtins(self.dt),
            **{
                builtin.name: builtin
                for group in (self._motion.builtins(), robot_builtins(self), extra_builtins(self))
                for builtin in group
            },
        }
        self._image = ProcessImage(self)
        if powered_on:
            self._power_goal = RobotMode.RUNNING
            self._enter_mode(RobotMode.RUNNING)
        self._image.update()

    # The control period.

    def tick(self) -> None:
        """Advance one control period."""
        self.tick_count += 1
        self.time = self.tick_count * self.dt
        if self.robot_mode != self._power_goal and self.time >= self._power_due:
            self._advance_power()
        if self._watchdogs:
            self._check_watchdogs()
        self._update_scale()
        if self._program is not None and self.runtime_state in _STEPPED:
            self._step(self._program)
        for secondary in tuple(self._secondary):
            self._step(secondary)
        self.compliance.step(self._hand_force(), self.tool)
        violation = self.arm.step()
        if violation is not None:
            self.protective_stop(violation.code, violation.joint)
        self._settle()
        self._image.update()

    def _step(self, runtime: ProgramRuntime) -> None:
        self.active_runtime = runtime
        try:
            runtime.step()
        except ScriptError as error:
            self.post(RuntimeExceptionMessage(error.line, error.column, error.text))
        finally:
            self.active_runtime = None
        if runtime.finished:
            if runtime is self._program:
                self._end_program()
            elif runtime in self._secondary:
                self._secondary.remove(runtime)

    def _update_scale(self) -> None:
        """Bring the speed scaling towards slider, safety limit and pause."""
        step = self.dt / SCALE_SECONDS
        limit = SAFETY_RULES[self.safety_mode].speed_limit
        slider = min(self.outputs["target_speed_fraction"], limit)
        pausing = self.runtime_state in (RuntimeState.PAUSING, RuntimeState.PAUSED)
        self._speed_slider = _ramp(self._speed_slider, slider, step)
        self._pause_factor = _ramp(self._pause_factor, 0.0 if pausing else 1.0, step)
        self.arm.scale = self._speed_slider * self._pause_factor

    def _settle(self) -> None:
        """Finish transitions that wait for the arm."""
        if self.runtime_state == RuntimeState.STOPPING:
            if not self.arm.moving:
                self.runtime_state = RuntimeState.STOPPED
        elif self.runtime_state == RuntimeState.PAUSING:
            if self._pause_factor == 0.0:
                self.runtime_state = RuntimeState.PAUSED
        elif self.runtime_state == RuntimeState.RESUMING and self._pause_factor == 1.0:
            self.runtime_state = RuntimeState.PLAYING
        stopped = self._rule.program is ProgramRule.STOP or not self.arm.enabled
        if stopped and not self.arm.moving and self.arm.target_q != self.arm.actual_q:
            self.arm.hold()

    def _hand_force(self) -> tuple[float, ...]:
        """Wrench that compliant modes feel, and the moment of the first contact."""
        wrench = self.force_sensor.applied
        if not self.force_sensor.use_external and not any(wrench):
            self._contact_tick = None
            return wrench
        if self.outputs["tcp_force_scalar"] < CONTACT_FORCE:
            self._contact_tick = None
        elif self._contact_tick is None:
            self._contact_tick = self.tick_count
        return self.force_sensor.tcp if self.force_sensor.use_external else wrench

    def _check_watchdogs(self) -> None:
        late = [
            (name, watchdog)
            for name, watchdog in self._watchdogs.items()
            if self.time - watchdog.kicked > watchdog.period + 0.5 * self.dt
        ]
        for name, watchdog in late:
            watchdog.kicked = self.time
            if watchdog.action == "ignore" or self.runtime_state != RuntimeState.PLAYING:
                continue
            text = f"RTDE watchdog: {name} was not written for {watchdog.period:g} s"
            self.post(ErrorMessage(0, 0, ReportLevel.WARNING, text))
            if watchdog.action == "stop":
                self._end_program()
            else:
                self.pause()

    # Programs.

    def prepare_script(self, text: str) -> None:
        """Compile a script ahead, in any thread, so that `run_script` need not wait for it."""
        with suppress(ScriptError):  # which `run_script` reports
            compile_program(text, self._builtins)

    def run_script(self, text: str) -> None:
        """Run a def or sec block, or a single line, from a script port. Errors become messages.

        A def block or a single statement replaces the running program; a sec block runs beside
        it. Panel commands ("power on", "stop program", ...) are obeyed.
        """
        if not self.remote and not self.model.is_cb3:
            self.post(
                ErrorMessage(
                    _NOT_IN_REMOTE, 0, ReportLevel.WARNING, "Script refused: not in remote control"
                )
            )
            return
        command = _LINE_COMMANDS.get(" ".join(text.split()))
        if command is not None:
            command(self)
            return
        try:
            program = compile_program(text, self._builtins)
        except ScriptError as error:
            self.post(RuntimeExceptionMessage(error.line, error.column, error.text))
            return
        runtime = ProgramRuntime(program, self.dt)
        runtime.on_thread_end = lambda handle: self._motion.release((runtime, handle))
        if program.kind == "sec":
            self._secondary.append(runtime)
            runtime.start()
            return
        if self._program is not None:
            self._end_program()
        if self.robot_mode != RobotMode.RUNNING or self._rule.program is not ProgramRule.RUN:
            state = f"{self.robot_mode.name}, {self.safety_mode.name}"
            self.post(
                ErrorMessage(
                    0, 0, ReportLevel.WARNING, f"Program {program.name} refused: robot is {state}"
                )
            )
            return
        self._program = runtime
        self.program_name = program.name
        self.runtime_state = RuntimeState.PLAYING
        self.post(KeyMessage("PROGRAM_XXX_STARTED", program.name))
        runtime.start()

    def _end_program(self) -> None:
        """Stop the program, let the arm slow down, leave what only a program can hold."""
        runtime = self._program
        if runtime is None:
            return
        self._program = None
        runtime.stop()
        self._watchdogs.clear()
        self.compliance.end()
        # The arm slows down from its present speed; the pause no longer counts.
        self.arm.plan_qd = [v * self._pause_factor for v in self.arm.plan_qd]
        self._pause_factor = 1.0
        self.runtime_state = RuntimeState.STOPPING if self.arm.moving else RuntimeState.STOPPED
        self.post(KeyMessage("PROGRAM_XXX_STOPPED", self.program_name))
        if self.program_ended is not None:
            self.program_ended()

    def caller(self) -> tuple[ProgramRuntime, int]:
        """Thread that runs now, for built-ins. Raises RuntimeError outside a program's step."""
        runtime = self.active_runtime
        if runtime is None or runtime.current_thread is None:
            raise RuntimeError("a built-in was called outside a running program")
        return runtime, runtime.current_thread

    def set_watchdog(self, variable: str, frequency: float, action: str) -> None:
        """Expect RTDE input `variable` at `frequency`, Hz; 0 ends the watch."""
        if frequency <= 0.0:
            self._watchdogs.pop(variable, None)
        else:
            self._watchdogs[variable] = _Watchdog(1.0 / frequency, action, self.time)

    # RTDE inputs and the I/O that they share with programs.

    def write_inputs(self, values: Mapping[str, Any]) -> None:
        """Take one RTDE input package: values by input variable name."""
        self.inputs.update(values)
        outputs = self.outputs
        for name in values:
            if name in outputs:  # input registers can be read back
                outputs[name] = values[name]
            if name in self._watchdogs:
                self._watchdogs[name].kicked = self.time
        if values.get("speed_slider_mask", 0):
            fraction = float(self.inputs["speed_slider_fraction"])
            outputs["target_speed_fraction"] = max(0.0, min(1.0, fraction))
        for kind, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = values.get(f"{kind}_digital_output_mask", 0)
            if mask:
                bits = self.inputs[f"{kind}_digital_output"]
                self.set_digital_outputs(mask << shift, bits << shift)
        mask = values.get("standard_analog_output_mask", 0)
        for channel in (0, 1):
            if mask >> channel & 1:
                bit = 1 << channel
                voltage = self.inputs["standard_analog_output_type"] & bit
                types = outputs["analog_io_types"] & ~(bit << 2)
                outputs["analog_io_types"] = types | (bit << 2 if voltage else 0)
                self.set_analog_output(channel, self.inputs[f"standard_analog_output_{channel}"])
        if "external_force_torque" in values:
            self.force_sensor.external = tuple(values["external_force_torque"])
            self.load_changed()

    def set_digital_outputs(self, mask: int, bits: int) -> None:
        """Set the outputs of `mask` to `bits`: 0-7 standard, 8-15 configurable, 16-17 tool."""
        present = self.outputs["actual_digital_output_bits"]
        self.outputs["actual_digital_output_bits"] = (present & ~mask) | (bits & mask)

    def set_digital_inputs(self, mask: int, bits: int) -> None:
        """Drive digital inputs from outside, numbered as the outputs."""
        present = self.outputs["actual_digital_input_bits"]
        self.outputs["actual_digital_input_bits"] = (present & ~mask) | (bits & mask)

    def set_analog_output(self, channel: int, ratio: float) -> None:
        """Set analog output 0 or 1 to `ratio` (0 to 1) of 4-20 mA or 0-10 V, by its type."""
        ratio = max(0.0, min(1.0, ratio))
        voltage = self.outputs["analog_io_types"] >> (2 + channel) & 1
        value = 10.0 * ratio if voltage else 0.004 + 0.016 * ratio
        self.outputs[f"standard_analog_output{channel}"] = value

    # Tool and load.

    def set_tcp(self, pose: tuple[float, ...]) -> None:
        """Set the TCP: a pose in the flange frame."""
        self.tcp = pose
        self.tool = to_transform(pose) if any(pose) else IDENTITY
        self.load_changed()

    def set_payload(self, mass: float, cog: tuple[float, ...], inertia: tuple[float, ...]) -> None:
        """Set the payload: kg, m (flange frame) and kg m^2 (Ixx Iyy Izz Ixy Ixz Iyz)."""
        self.payload, self.payload_cog, self.payload_inertia = mass, cog, inertia
        self.load_changed()

    def set_gravity(self, gravity: tuple[float, ...]) -> None:
        """Set the upward acceleration that the base feels, m/s^2."""
        self.gravity = gravity
        self.load_changed()

    def load_changed(self) -> None:
        """Have outputs that depend on tool, load and forces computed again."""
        self.load_revision += 1

    def mass_matrix(self, q: Floats) -> Matrix:
        """Mass matrix with the present payload, kg m^2."""
        return self.dynamics.mass_matrix(q, self.payload, self.payload_cog)

    def contact_steps(self) -> int:
        """Periods since the tool was first touched, 0 when it is free."""
        return 0 if self._contact_tick is None else self.tick_count - self._contact_tick + 1

    # Messages and pop-ups.

    def post(self, message: Message) -> None:
        """Queue a message for the primary clients."""
        self._messages.append(message)

    def take_messages(self) -> list[Message]:
        """Messages since the last call, oldest first."""
        taken, self._messages = self._messages, []
        return taken

    def open_popup(
        self, text: str, title: str = "", *, warning: bool = False, error: bool = False
    ) -> None:
        """Show a pop-up on the panel."""
        self.popup_text = text
        self.post(PopupMessage(title, text, warning, error))

    def close_popup(self) -> bool:
        """Close the pop-up; a program that waits on it goes on."""
        self.popup_text = None
        return True

    # Panel and dashboard: each True when accepted, False when refused in the present state.

    def power_on(self) -> bool:
        """Power the arm: POWER_OFF -> POWER_ON -> IDLE."""
        if not self._rule.keeps_power:
            return False
        return self._power_up(RobotMode.IDLE)

    def brake_release(self) -> bool:
        """Release the brakes: IDLE -> RUNNING, powering the arm first where needed."""
        if self._rule.program is ProgramRule.STOP:
            return False
        return self._power_up(RobotMode.RUNNING)

    def power_off(self) -> bool:
        """Stop the program and cut the power of the arm."""
        self._end_program()
        if self.robot_mode != RobotMode.POWER_OFF:
            self._power_goal = RobotMode.POWER_OFF
            self._power_due = self.time + POWER_OFF_SECONDS
        return True

    def play(self) -> bool:
        """Start the loaded program, or resume the paused one."""
        ready = self.robot_mode == RobotMode.RUNNING and self._rule.program is ProgramRule.RUN
        if not ready:
            return False
        if self.runtime_state in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            self.runtime_state = RuntimeState.RESUMING
            for watchdog in self._watchdogs.values():
                watchdog.kicked = self.time
            return True
        if self.runtime_state not in _PLAYABLE or not self.loaded_program:
            return False
        self.run_script(self.programs[self.loaded_program])
        return self._program is not None

    def pause(self) -> bool:
        """Pause the running program."""
        if self.runtime_state not in (RuntimeState.PLAYING, RuntimeState.RESUMING):
            return False
        self.runtime_state = RuntimeState.PAUSING
        return True

    def stop(self) -> bool:
        """Stop the program."""
        self._end_program()
        return True

    def unlock_protective_stop(self) -> bool:
        """Leave a protective stop. Refused in its first 5 s."""
        if SafetyMode.PROTECTIVE_STOP not in self._causes:
            return True
        if self.time - self._protective_stop_time < PROTECTIVE_STOP_LOCK_SECONDS:
            return False
        self._clear(SafetyMode.PROTECTIVE_STOP)
        return True

    def restart_safety(self) -> bool:
        """Leave a violation or fault; the arm is powered off afterwards."""
        self._end_program()
        self._enter_mode(RobotMode.POWER_OFF)
        self._power_goal = RobotMode.POWER_OFF
        self._clear(SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.PROTECTIVE_STOP)
        return True

    def load_program(self, name: str) -> bool:
        """Load a stored program; refused while a program runs or when there is none such."""
        if name not in self.programs or self.runtime_state in _ACTIVE:
            return False
        self.loaded_program = name
        return True

    def set_operational_mode(self, mode: str) -> bool:
        """Set "MANUAL" or "AUTOMATIC", or give the choice back to the panel with "NONE"."""
        if mode not in OPERATIONAL_MODES:
            return False
        self.operational_mode = mode
        return True

    # What happens to a robot.

    def protective_stop(self, reason_code: int = 158, argument: int = 0) -> None:
        """Stop protectively, with an entry `reason_code` in the error log.

        Without effect on an arm that is powered off or already stopped protectively.
        """
        if self.robot_mode not in _UNDER_POWER or SafetyMode.PROTECTIVE_STOP in self._causes:
            return
        text = STOP_REASONS.get(reason_code, "Protective Stop")
        self.post(ErrorMessage(reason_code, argument, ReportLevel.VIOLATION, text))
        self._protective_stop_time = self.time
        self._cause(SafetyMode.PROTECTIVE_STOP)

    def emergency_stop(self) -> None:
        """Press the emergency stop button of the robot."""
        self._cause(SafetyMode.ROBOT_EMERGENCY_STOP)

    def release_emergency_stop(self) -> None:
        """Pull the emergency stop button out again; the arm is left powered off."""
        self._clear(SafetyMode.ROBOT_EMERGENCY_STOP)

    def safeguard_stop(self, on: bool) -> None:
        """Open (`on`) or close the safeguard input. The program stays paused until `play`."""
        self._set_cause(SafetyMode.SAFEGUARD_STOP, on)

    def reduced_mode(self, on: bool) -> None:
        """Enter or leave the reduced safety mode."""
        self._set_cause(SafetyMode.REDUCED, on)

    def set_remote(self, on: bool) -> None:
        """Switch between remote and local control."""
        self.remote = on

    def violation(self) -> None:
        """Enter the safety mode VIOLATION."""
        self._cause(SafetyMode.VIOLATION)

    def fault(self) -> None:
        """Enter the safety mode FAULT."""
        self._cause(SafetyMode.FAULT)

    def power_loss(self) -> None:
        """Lose the power of the arm without notice; the brakes fall in."""
        self._power_goal = RobotMode.POWER_OFF
        self._enter_mode(RobotMode.POWER_OFF)
        self._end_program()
        self.post(ErrorMessage(0, 0, ReportLevel.FAULT, "Robot power lost"))

    def freeze_joint(self, index: int, on: bool = True) -> None:
        """Block joint `index` (0 to 5) mechanically, or free it again."""
        if not 0 <= index < 6:
            raise ValueError(f"joint index {index} is not within 0 to 5")
        if on:
            self.arm.frozen.add(index)
        else:
            self.arm.frozen.discard(index)

    def external_force(self, wrench: Sequence[float]) -> None:
        """Push with `wrench` (fx fy fz N, tx ty tz N.m) at the TCP, in the axes of the base."""
        if len(wrench) != 6:
            raise ValueError(f"a wrench has six items, got {len(wrench)}")
        self.force_sensor.applied = tuple(float(x) for x in wrench)
        self.load_changed()

    # Safety and power.

    @property
    def _rule(self) -> SafetyRule:
        return SAFETY_RULES[self.safety_mode]

    def _set_cause(self, cause: SafetyMode, on: bool) -> None:
        if on:
            self._cause(cause)
        else:
            self._clear(cause)

    def _cause(self, cause: SafetyMode) -> None:
        self._causes.add(cause)
        self._apply_safety()

    def _clear(self, *causes: SafetyMode) -> None:
        self._causes.difference_update(causes)
        self._apply_safety()

    def _apply_safety(self) -> None:
        """Take over the gravest safety mode and do to program and power what it asks."""
        mode = gravest(self._causes)
        if mode != self.safety_mode:
            self.safety_mode = mode
            self.post(SafetyModeMessage(int(mode)))
            _log.info("safety mode %s", mode.name)
        rule = self._rule
        self.arm.stop_deceleration = rule.deceleration
        if rule.program is ProgramRule.STOP:
            self._end_program()
        elif rule.program is ProgramRule.PAUSE:
            self.pause()
        if not rule.keeps_power:
            self.power_off()

    def _power_up(self, goal: RobotMode) -> bool:
        if self.robot_mode >= goal:
            return True
        if self._power_goal <= self.robot_mode:  # at rest, or on the way down
            self._power_due = self.time + POWER_UP[self.robot_mode][0]
        self._power_goal = max(goal, self._power_goal)
        return True

    def _advance_power(self) -> None:
        if self._power_goal == RobotMode.POWER_OFF:
            self._enter_mode(RobotMode.POWER_OFF)
            return
        self._enter_mode(POWER_UP[self.robot_mode][1])
        if self.robot_mode != self._power_goal:
            self._power_due = self.time + POWER_UP[self.robot_mode][0]

    def _enter_mode(self, mode: RobotMode) -> None:
        self.robot_mode = mode
        self.arm.enabled = mode == RobotMode.RUNNING
        if not self.arm.enabled:
            self.compliance.end()


def _ramp(value: float, goal: float, step: float) -> float:
    return min(goal, value + step) if value < goal else max(goal, value - step)


_LINE_COMMANDS: Final[dict[str, Callable[[Controller], object]]] = {
    "stop program": Controller.stop,
    "pause program": Controller.pause,
    "resume program": Controller.play,
    "run program": Controller.play,
    "power on": Controller.power_on,
    "power off": Controller.power_off,
    "set robotmode run": Controller.brake_release,
    "set unlock protective stop": Controller.unlock_protective_stop,
    "unlock protective stop": Controller.unlock_protective_stop,
    "close popup": Controller.close_popup,
}
"""Lines of the script ports that are no URScript."""
