"""The simulated controller: one control period per `tick`, without sockets and without a clock."""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.defects import ArmDefects
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    Message,
    PopupMessage,
    ReportLevel,
    SafetyModeMessage,
)
from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.motion.contact import Surface, Surroundings
from crtk_sim_backends.ur.motion.control import MotionControl
from crtk_sim_backends.ur.motion.kinematics import Floats
from crtk_sim_backends.ur.motion.limits import SafetyLimits, collision_code
from crtk_sim_backends.ur.motion.moves import Moves
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.motion.streams import Streams
from crtk_sim_backends.ur.program.conveyor_library import conveyor_builtins
from crtk_sim_backends.ur.program.force_library import force_builtins
from crtk_sim_backends.ur.program.interpreter import Interpreter
from crtk_sim_backends.ur.program.io_library import io_builtins
from crtk_sim_backends.ur.program.player import RAMP_SECONDS, ProgramPlayer, ramp
from crtk_sim_backends.ur.program.pose_library import pose_builtins
from crtk_sim_backends.ur.program.programs import ProgramError, ProgramFiles
from crtk_sim_backends.ur.program.robot_library import robot_builtins
from crtk_sim_backends.ur.program.settings_library import settings_builtins
from crtk_sim_backends.ur.program.signal_library import signal_builtins
from crtk_sim_backends.ur.safety.modes import (
    POWER_SECONDS,
    PROTECTIVE_STOP_LOCK_SECONDS,
    STOP_REASONS,
    ProgramRule,
    RobotMode,
    RuntimeState,
    SafetyMode,
    stop_level,
)
from crtk_sim_backends.ur.safety.power import ArmPower
from crtk_sim_backends.ur.safety.system import OPERATIONAL_MODES, SafetySystem
from crtk_sim_backends.ur.signals import variables
from crtk_sim_backends.ur.signals.control_box import Signals
from crtk_sim_backends.ur.signals.encoders import Encoders
from crtk_sim_backends.ur.signals.port_map import PortMap
from crtk_sim_backends.ur.signals.process_image import ProcessImage
from crtk_sim_backends.ur.signals.state_signals import StateSignals
from crtk_sim_backends.ur.signals.tool_line import LineSettings
from crtk_sim_backends.ur.signals.wiring import Wire
from crtk_sim_backends.ur.urscript import PURE_BUILTINS, Builtin, timing_builtins
from crtk_sim_backends.ur.urscript.arguments import LARGEST

LOG_SIZE: Final = 200

_NOT_IN_REMOTE: Final = 210
_PLAYABLE: Final[tuple[RuntimeState, ...]] = (RuntimeState.STOPPED, RuntimeState.STOPPING)
_FAILURES: Final = (SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT)
_UNDER_POWER: Final = (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)

_log = logging.getLogger(__name__)


def no_builtins(controller: Controller) -> Iterable[Builtin]:
    """Add nothing to the built-ins of a controller."""
    return ()


class Controller:
    """One robot and its controller in virtual time. Not thread-safe: one thread drives it.

    Args:
        model: arm, from `models.MODELS`.
        version: software version (major, minor, bugfix, build).
        powered_on: start in RUNNING with the brakes released, else in POWER_OFF.
        remote: start in remote control; CB3 has nothing else.
        remote_enforced: refuse remote clients in local control.
        wires: outputs that are connected to inputs.
        boot_seconds: time from the start to POWER_OFF; 0.0: it has been on for long.
        power_seconds: time from there to RUNNING.
        lock_seconds: time for which a protective stop cannot be unlocked.
        programs: what `load` finds.
        surfaces: what the tool can touch.
        limits: at which the arm stops protectively.
        defects: of groups of joints.
        extra_builtins: URScript built-ins to add (the socket functions of `script_sockets`).

    Attributes:
        clock: advances in `tick` alone, by 1/500 s (e-Series and later) or 1/125 s (CB3).
        plant: the mechanics: arm, tool and load.
        outputs: process image by RTDE output variable name, valid after each `tick`.
        inputs: the same by RTDE input variable name.
        popup_text: text of the open pop-up, or None.
        user_role: role that the dashboard of a CB3 controller set.
        programs: stored programs and installations, and which of them are loaded.
        safety: the safety system.
        log: time and content of the last messages, and of what clients added.
        player: runs the programs.
        interpreter: adds statements to them, in interpreter mode.
        signals: digital and analog signals.
        port_map: registers and bits of its Modbus server.
        state_signals: outputs that follow the state, and inputs that act.
        encoders: of conveyors.
        tool_communication: settings of the serial line to the tool; see `set_tool_communication`.
        surroundings: what acts on the tool.
    """

    def __init__(
        self,
        model: RobotModel,
        version: tuple[int, int, int, int],
        *,
        powered_on: bool = True,
        remote: bool = True,
        remote_enforced: bool = True,
        wires: Iterable[Wire] = (),
        boot_seconds: float = 0.0,
        power_seconds: float = POWER_SECONDS,
        lock_seconds: float = PROTECTIVE_STOP_LOCK_SECONDS,
        programs: ProgramFiles | None = None,
        surfaces: Sequence[Surface] = (),
        limits: SafetyLimits | None = None,
        defects: Sequence[ArmDefects] = (),
        extra_builtins: Callable[[Controller], Iterable[Builtin]] = no_builtins,
    ) -> None:
        self.model = model
        self.version: tuple[int, int, int, int] = version
        self.clock = Clock(1.0 / model.frequency)
        self.outputs: dict[str, Any] = variables.initial_image(variables.OUTPUTS)
        self.inputs: dict[str, Any] = variables.initial_image(variables.INPUTS)
        self.spoiled: dict[str, tuple[int, float]] = {}
        self._remote_switch: bool = remote or model.is_cb3
        self._remote_enforced = remote_enforced
        self.popup_text: str | None = None
        self.user_role: str = "PROGRAMMER"
        self.programs: ProgramFiles = programs or ProgramFiles()
        self.safety = SafetySystem(lock_seconds)
        self._shown_safety_mode: SafetyMode = self.safety.mode
        self.signals: Signals = Signals(self.inputs, self.outputs, wires)
        self.port_map = PortMap(
            self.version, self.clock, self.inputs, self.outputs, self.signals, self.write_inputs
        )
        self.tool_communication = LineSettings()
        self.encoders = Encoders(self.outputs, self.dt)
        self.plant = Plant(model, self.dt)
        self.surroundings: Surroundings = Surroundings(
            self.plant.force_sensor, self.outputs, self.plant.load_changed, surfaces
        )
        self.limits = limits or SafetyLimits()

        self.log: deque[tuple[float, Message | str]] = deque(maxlen=LOG_SIZE)
        self._messages: list[Message] = []
        self._power = ArmPower(boot_seconds, power_seconds)
        self._speed_slider = 1.0  # ramped towards target_speed_fraction
        self.player: ProgramPlayer = ProgramPlayer(self)
        self.player.has_watchdogs = not any(group.ignores_watchdog for group in defects)
        self._has_button = not any(group.ignores_emergency_stop for group in defects)
        self.state_signals = StateSignals(self._power, self.player, self.plant.compliance)
        motion = MotionControl(
            self.plant,
            self.clock,
            self.player.caller,
            self.protective_stop,
            self.limits.tool_speed,
        )
        self.player.thread_ended.append(motion.release)
        self._moves = Moves(motion, self.post)
        self.interpreter = Interpreter(self.player, self.clock, self.note, self._moves.abort)
        self.player.set_builtins(
            {
                **PURE_BUILTINS,
                **timing_builtins(self.dt),
                **{
                    builtin.name: builtin
                    for group in (
                        self._moves.builtins(),
                        Streams(motion).builtins(),
                        pose_builtins(),
                        settings_builtins(),
                        robot_builtins(self),
                        force_builtins(
                            self.plant, self.surroundings, self.outputs, self.player.watch_forces
                        ),
                        conveyor_builtins(self.encoders, motion),
                        io_builtins(self.inputs, self.outputs, self.player, self.port_map),
                        signal_builtins(self),
                        self.interpreter.builtins(),
                        extra_builtins(self),
                    )
                    for builtin in group
                },
            }
        )
        self._image = ProcessImage(self, defects)
        if powered_on:
            self._power.start(RobotMode.RUNNING)
            self._power_changed()
        self._image.update()

    # The control period.

    def tick(self) -> None:
        """Advance one control period."""
        self.clock.advance()
        if self._power.advance(self.time):
            self._power_changed()
        self._update_scale()
        self.encoders.step()
        self.player.step()
        self.surroundings.act()
        beside = self.plant.leave_plan(self.player.pause_factor)
        for violation in (beside, self.plant.arm.step()):
            if violation is not None:
                self.protective_stop(violation.code, violation.argument)
        self._settle()
        self.state_signals.update()
        self._image.update()
        exceeded = self.limits.violation(self.outputs, self.model.torque)
        if exceeded is not None:
            self.protective_stop(*exceeded)

    @property
    def dt(self) -> float:
        """Control period, s."""
        return self.clock.dt

    @property
    def tick_count(self) -> int:
        """Periods since start."""
        return self.clock.ticks

    @property
    def time(self) -> float:
        """Seconds since start."""
        return self.clock.time

    def _update_scale(self) -> None:
        """Bring the speed scaling towards slider, safety limit and pause."""
        limit = self.safety.rule.speed_limit
        slider = min(self.outputs["target_speed_fraction"], limit)
        self._speed_slider = ramp(self._speed_slider, slider, self.dt / RAMP_SECONDS)
        self.player.ramp()
        self.plant.arm.scale = self._speed_slider * self.player.pause_factor

    @property
    def speed_scaling(self) -> float:
        """What slows programs down beside the speed slider, 0 to 1: pause, reduced mode.

        Times `target_speed_fraction` it is how fast they go, as clients of the robot reckon.
        """
        fraction = self.outputs["target_speed_fraction"]
        return min(1.0, self.plant.arm.scale / fraction) if fraction else self.player.pause_factor

    def _settle(self) -> None:
        """Finish transitions that wait for the arm."""
        self.player.settle()
        arm = self.plant.arm
        stopped = self.safety.rule.program is ProgramRule.STOP or not arm.enabled
        if stopped and not arm.moving and arm.target_q != arm.actual_q:
            arm.hold()
        if self.safety.settle(self.time, powered=self.robot_mode > RobotMode.POWER_OFF):
            self._apply_safety()

    # Control, power and programs.

    @property
    def remote(self) -> bool:
        """Whether remote clients have control: neither on the pendant's switch nor in manual mode.

        A CB3 controller has no such switch.
        """
        return self._remote_switch and not self.safety.manual

    @property
    def obeys_clients(self) -> bool:
        """Whether remote clients may do more than ask."""
        return self.remote or not self._remote_enforced

    @property
    def operational_mode(self) -> str:
        """What remote clients control: one of `safety_system.OPERATIONAL_MODES`."""
        return self.safety.operational_mode

    @property
    def safety_mode(self) -> SafetyMode:
        """The safety mode that shows."""
        return self.safety.mode

    @property
    def robot_mode(self) -> RobotMode:
        """How far the arm is powered."""
        return self._power.mode

    @property
    def runtime_state(self) -> RuntimeState:
        """State of the program."""
        return self.player.state

    @property
    def program_name(self) -> str:
        """Name of the running or last program, "" before the first."""
        return self.player.name

    @property
    def can_play(self) -> bool:
        """Whether power and safety permit a program to run."""
        return self.robot_mode == RobotMode.RUNNING and self.safety.rule.program is ProgramRule.RUN

    def prepare_script(self, text: str) -> None:
        """Compile a script ahead, in any thread, so that `run_script` need not wait for it."""
        self.player.prepare(text)

    def run_script(self, text: str) -> None:
        """Run a def or sec block, or a single line, from a script port. Errors become messages.

        A def block or a single statement replaces the running program; a sec block runs beside
        it. Panel commands ("power on", "stop program", ...) are obeyed.
        """
        if not self.obeys_clients:
            self.post(
                ErrorMessage(
                    _NOT_IN_REMOTE, 0, ReportLevel.WARNING, "Script refused: not in remote control"
                )
            )
            return
        line = " ".join(text.split())
        command = _LINE_COMMANDS.get(line)
        speed = _SET_SPEED.fullmatch(line)
        if command is not None:
            command(self)
        elif speed is not None:
            self.outputs["target_speed_fraction"] = min(1.0, float(speed[1]))
        else:
            self.player.run(text)

    # RTDE inputs and the I/O that they share with programs.

    def write_inputs(self, values: Mapping[str, Any]) -> None:
        """Take one RTDE input package: values by input variable name."""
        self.inputs.update(values)
        outputs = self.outputs
        for name in values:
            if name in outputs:  # input registers can be read back
                outputs[name] = values[name]
            self.player.written(name)
        if values.get("speed_slider_mask", 0):
            fraction = float(self.inputs["speed_slider_fraction"])
            outputs["target_speed_fraction"] = max(0.0, min(1.0, fraction))
        self.signals.take(values)
        if "external_force_torque" in values:
            wrench = tuple(values["external_force_torque"])
            if all(abs(x) <= LARGEST for x in wrench):  # the rest is no measurement
                self.plant.force_sensor.external = wrench
                self.plant.load_changed()

    def set_tool_communication(self, settings: LineSettings) -> None:
        """Set the serial line to the tool. It takes the wires of the tool's analog inputs."""
        self.tool_communication = settings
        self.signals.connect_tool_analog(not settings.enabled)

    @property
    def waypoint(self) -> Floats | None:
        """Pose to which the running move goes, None when none runs."""
        return self._moves.waypoint

    # Messages and pop-ups.

    def note(self, text: str) -> None:
        """Enter a text in the log."""
        self.log.append((self.time, text))

    def post(self, message: Message) -> None:
        """Queue a message for the primary clients, and enter it in the log."""
        self._messages.append(message)
        self.log.append((self.time, message))
        if isinstance(message, ErrorMessage) and self.player.pauses_on & {
            (message.code, None),
            (message.code, message.argument),
        }:
            self.pause()

    def take_messages(self) -> list[Message]:
        """Messages since the last call, oldest first."""
        taken, self._messages = self._messages, []
        return taken

    def open_popup(
        self,
        text: str,
        title: str = "",
        *,
        warning: bool = False,
        error: bool = False,
        blocking: bool = False,
    ) -> None:
        """Show a pop-up of a program on the panel; a `blocking` one holds the program up."""
        self.popup_text = text
        self.post(PopupMessage(title, text, warning, error, blocking))

    def close_popup(self) -> bool:
        """Close the pop-up; a program that waits on it goes on."""
        self.popup_text = None
        return True

    # Panel and dashboard: each True when accepted, False when refused in the present state.

    def power_on(self) -> bool:
        """Power the arm: POWER_OFF -> POWER_ON -> IDLE."""
        if not self.safety.rule.keeps_power:
            return False
        return self._power.up(RobotMode.IDLE, self.time)

    def brake_release(self) -> bool:
        """Release the brakes: IDLE -> RUNNING, powering the arm first where needed."""
        if self.safety.rule.program is ProgramRule.STOP:
            return False
        return self._power.up(RobotMode.RUNNING, self.time)

    def power_off(self) -> bool:
        """Stop the program and cut the power of the arm."""
        self.player.end()
        self._power.off(self.time)
        return True

    def play(self) -> bool:
        """Start the loaded program, or resume the paused one."""
        if not self.can_play:
            return False
        if self.player.resume():
            return True
        if self.runtime_state not in _PLAYABLE or not self.programs.loaded:
            return False
        self.player.run(self.programs.text)
        return self.player.loaded

    def pause(self) -> bool:
        """Pause the running program."""
        return self.player.pause()

    def stop(self) -> bool:
        """Stop the program."""
        self.player.end()
        return True

    def unlock_protective_stop(self, *, at_once: bool = False) -> bool:
        """Leave a protective stop. Refused while it is locked, but for `at_once`.

        It is PolyScope that keeps the five seconds; the script ports reach the controller behind it
        (tests of UR's client library unlock there within a second).
        """
        if not self.safety.stopped_protectively:
            return True
        unlocked = self.safety.unlock_protective_stop(self.time, at_once=at_once)
        self._apply_safety()
        return unlocked

    def restart_safety(self) -> bool:
        """Leave a violation or fault; the arm is powered off afterwards."""
        self.player.end()
        self._cut_power()
        self.safety.restart()
        self._apply_safety()
        return True

    def load_program(self, name: str) -> None:
        """Load a stored program.

        Raises:
            FileNotFoundError: there is none such.
            ProgramError: it cannot be loaded, or a program runs.
        """
        text = self.programs.read(name)
        if self.player.loaded:
            raise ProgramError(f"{self.program_name} runs")
        error = self.player.check(text)
        if error is not None:
            raise ProgramError(f"line {error.line}: {error.text}")
        self.programs.load(name, text)

    def load_installation(self, name: str) -> None:
        """Load a stored installation; like `load_program`."""
        if not self.programs.has_installation(name):
            raise FileNotFoundError(name)
        if self.player.loaded:
            raise ProgramError(f"{self.program_name} runs")
        self.programs.load_installation(name)

    def set_operational_mode(self, mode: str) -> bool:
        """Set "MANUAL" or "AUTOMATIC", or give the choice back to the panel with "NONE".

        Remote control ends in manual mode, and what remote clients run with it. The mode stays when
        the choice is given back (tests of UR's client library: no remote control after it).
        """
        if mode not in OPERATIONAL_MODES or self.model.is_cb3:
            return False
        if mode == "MANUAL" and self.remote and self._remote_enforced:
            self.player.end_all()
        self.safety.set_operational_mode(mode)
        self._apply_safety()
        return True

    # What happens to a robot.

    def protective_stop(self, reason_code: int = 0, argument: int = 0) -> None:
        """Stop protectively, with an entry `reason_code` in the error log; 0: that of a collision.

        Without effect on an arm that is powered off or already stopped protectively.
        """
        if self.robot_mode not in _UNDER_POWER or self.safety.stopped_protectively:
            return
        reason_code = reason_code or collision_code(self.outputs["payload"])
        text = STOP_REASONS.get((reason_code, argument), "Protective Stop")
        self.post(ErrorMessage(reason_code, argument, stop_level(reason_code), text))
        self.safety.stop_protectively(self.time)
        self._apply_safety()

    def emergency_stop(self, button: SafetyMode = SafetyMode.ROBOT_EMERGENCY_STOP) -> None:
        """Press an emergency stop button: a stop of category 1, then no power.

        Args:
            button: ROBOT_EMERGENCY_STOP (on the pendant) or SYSTEM_EMERGENCY_STOP (of the cell).
        """
        if self._has_button or button is not SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety.press_emergency_stop(button, self.time)
            self._apply_safety()

    def release_emergency_stop(self, button: SafetyMode = SafetyMode.ROBOT_EMERGENCY_STOP) -> None:
        """Pull the emergency stop button out again; the arm is left powered off.

        A stop that has begun is completed: until the arm is without power the safety mode stays.
        """
        self.safety.release_emergency_stop(button)

    def safeguard_stop(self, on: bool) -> None:
        """Open (`on`) or close the safeguard input. The program stays paused until `play`."""
        self._set_cause(SafetyMode.SAFEGUARD_STOP, on)

    def automatic_safeguard_stop(self, on: bool) -> None:
        """The same for the safeguard input that counts in automatic mode alone."""
        self.safety.open_automatic_safeguard(on)
        self._apply_safety()

    def hold_enabling_device(self, held: bool) -> None:
        """Hold or let go of the three-position enabling device, which counts in manual mode."""
        self.safety.hold_enabling_device(held)
        self._apply_safety()

    def reduced_mode(self, on: bool) -> None:
        """Enter or leave the reduced safety mode."""
        self._set_cause(SafetyMode.REDUCED, on)

    def recovery_mode(self, on: bool) -> None:
        """Enter or leave recovery: the arm stands outside of a safety limit, no program runs."""
        self._set_cause(SafetyMode.RECOVERY, on)

    def set_remote(self, on: bool) -> None:
        """Switch between remote and local control; a CB3 controller has no such switch.

        In local control the pendant alone controls the robot: what remote clients run, stops.
        """
        if self.model.is_cb3:
            return
        if not on and self._remote_enforced:
            self.player.end_all()
        self._remote_switch = on

    def violation(self) -> None:
        """Enter the safety mode VIOLATION."""
        self._set_cause(SafetyMode.VIOLATION, True)

    def fault(self) -> None:
        """Enter the safety mode FAULT."""
        self._set_cause(SafetyMode.FAULT, True)

    def power_loss(self) -> None:
        """Lose the power of the arm without notice; the brakes fall in."""
        self._cut_power()
        self.player.end()
        self.post(ErrorMessage(0, 0, ReportLevel.FAULT, "Robot power lost"))

    def spoil(self) -> dict[str, Any]:
        """Outputs of `spoiled` (index and value by name), as RTDE clients see them."""
        found: dict[str, Any] = {}
        for name, (index, value) in self.spoiled.items():
            present = self.outputs[name]
            if isinstance(present, tuple):
                found[name] = (*present[:index], value, *present[index + 1 :])
            else:
                found[name] = value
        return found

    def freeze_joint(self, index: int, on: bool = True) -> None:
        """Block joint `index` (0 to 5) mechanically, or free it again."""
        if not 0 <= index < 6:
            raise ValueError(f"joint index {index} is not within 0 to 5")
        if on:
            self.plant.arm.frozen.add(index)
        else:
            self.plant.arm.frozen.discard(index)

    def external_force(self, wrench: Sequence[float]) -> None:
        """Push with `wrench` (fx fy fz N, tx ty tz N.m) at the TCP, in the axes of the base."""
        self.surroundings.push(wrench)

    # Safety and power.

    def _set_cause(self, cause: SafetyMode, on: bool) -> None:
        self.safety.set(cause, on)
        self._apply_safety()

    def _apply_safety(self) -> None:
        """Do to program and power what the safety mode asks."""
        mode = self.safety.mode
        if mode != self._shown_safety_mode:
            self._shown_safety_mode = mode
            self.post(SafetyModeMessage(int(mode)))
            _log.info("safety mode %s", mode.name)
        rule = self.safety.rule
        self.plant.arm.stop_deceleration = rule.deceleration
        if rule.program is ProgramRule.STOP:
            self.player.end(failed=mode in _FAILURES)
        elif rule.program is ProgramRule.PAUSE:
            self.pause()
        if not rule.keeps_power:
            self.power_off()

    def _cut_power(self) -> None:
        self._power.set(RobotMode.POWER_OFF)
        self._power_changed()

    def _power_changed(self) -> None:
        self.plant.arm.enabled = self.robot_mode == RobotMode.RUNNING
        if not self.plant.arm.enabled:
            self.plant.end_modes()


def _unlock_at_once(controller: Controller) -> None:
    controller.unlock_protective_stop(at_once=True)


_LINE_COMMANDS: Final[dict[str, Callable[[Controller], object]]] = {
    "stop program": Controller.stop,
    "pause program": Controller.pause,
    "resume program": Controller.play,
    "run program": Controller.play,
    "power on": Controller.power_on,
    "power off": Controller.power_off,
    "set robotmode run": Controller.brake_release,
    "set unlock protective stop": _unlock_at_once,
    "unlock protective stop": _unlock_at_once,
    "close popup": Controller.close_popup,
}
"""Lines of the script ports that are no URScript."""

_SET_SPEED: Final = re.compile(r"set speed (\d*\.?\d+)")
"""Another one; programs send it to their own controller."""
