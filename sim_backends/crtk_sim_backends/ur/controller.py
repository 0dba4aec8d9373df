"""The simulated controller: one control period per `tick`, without sockets and without a clock."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from crtk_sim_backends.ur import variables
from crtk_sim_backends.ur.arguments import LARGEST
from crtk_sim_backends.ur.arm import Arm
from crtk_sim_backends.ur.compliance import Compliance
from crtk_sim_backends.ur.dynamics import Dynamics
from crtk_sim_backends.ur.force_library import CONTACT_FORCE, force_builtins
from crtk_sim_backends.ur.force_sensor import ForceSensor
from crtk_sim_backends.ur.io_library import io_builtins
from crtk_sim_backends.ur.kinematics import IDENTITY, Floats, Kinematics, Matrix, to_transform
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    Message,
    PopupMessage,
    ReportLevel,
    SafetyModeMessage,
)
from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.motion import MotionLibrary
from crtk_sim_backends.ur.player import RAMP_SECONDS, ProgramPlayer, ramp
from crtk_sim_backends.ur.port_map import PortMap
from crtk_sim_backends.ur.power import ArmPower
from crtk_sim_backends.ur.process_image import ProcessImage
from crtk_sim_backends.ur.robot_library import robot_builtins
from crtk_sim_backends.ur.safety import (
    POWER_OFF_SECONDS,
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
from crtk_sim_backends.ur.signal_library import signal_builtins
from crtk_sim_backends.ur.signals import Signals
from crtk_sim_backends.ur.state_signals import StateSignals
from crtk_sim_backends.ur.tool_line import LineSettings
from crtk_sim_backends.ur.urscript import PURE_BUILTINS, Builtin, timing_builtins
from crtk_sim_backends.ur.wiring import Wire

IDLE_PROGRAM: Final = "def {}():\n  while (True):\n    sleep(0.1)\n  end\nend\n"
STORED_PROGRAMS: Final = ("external_control.urp", "simulation.urp")
OPERATIONAL_MODES: Final = ("NONE", "MANUAL", "AUTOMATIC")

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
        wires: outputs that are connected to inputs.
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
        player: runs the programs.
        signals: digital and analog signals.
        port_map: registers and bits of its Modbus server.
        state_signals: outputs that follow the state, and inputs that act.
        tool_communication: settings of the serial line to the tool; see `set_tool_communication`.
    """

    def __init__(
        self,
        model: RobotModel,
        version: tuple[int, int, int, int],
        *,
        powered_on: bool = True,
        remote: bool = True,
        wires: Iterable[Wire] = (),
        extra_builtins: Callable[[Controller], Iterable[Builtin]] = no_builtins,
    ) -> None:
        self.model = model
        self.version: tuple[int, int, int, int] = version
        self.dt = 1.0 / model.frequency
        self.tick_count = 0
        self.time = 0.0
        self.outputs: dict[str, Any] = variables.initial_image(variables.OUTPUTS)
        self.inputs: dict[str, Any] = variables.initial_image(variables.INPUTS)
        self.remote: bool = remote or model.is_cb3
        self.operational_mode: str = "NONE"
        self.popup_text: str | None = None
        self.programs = {
            name: IDLE_PROGRAM.format(name.removesuffix(".urp")) for name in STORED_PROGRAMS
        }
        self.loaded_program: str = ""

        self.safety_mode: SafetyMode = SafetyMode.NORMAL
        self.signals: Signals = Signals(self.inputs, self.outputs, wires)
        self.port_map = PortMap(self)
        self.state_signals = StateSignals(self)
        self.tool_communication = LineSettings()
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
        self._emergency_pressed = False
        self._emergency_end = 0.0
        self._power = ArmPower()
        self._speed_slider = 1.0  # ramped towards target_speed_fraction
        self._contact_tick: int | None = None
        motion = MotionLibrary(self)
        self.player = ProgramPlayer(self, motion.release)
        self.player.set_builtins(
            {
                **PURE_BUILTINS,
                **timing_builtins(self.dt),
                **{
                    builtin.name: builtin
                    for group in (
                        motion.builtins(),
                        robot_builtins(self),
                        force_builtins(self),
                        io_builtins(self),
                        signal_builtins(self),
                        extra_builtins(self),
                    )
                    for builtin in group
                },
            }
        )
        self._image = ProcessImage(self)
        if powered_on:
            self._power.set(RobotMode.RUNNING)
            self._power_changed()
        self._image.update()

    # The control period.

    def tick(self) -> None:
        """Advance one control period."""
        self.tick_count += 1
        self.time = self.tick_count * self.dt
        if self._power.advance(self.time):
            self._power_changed()
        self._update_scale()
        self.player.step()
        self.compliance.step(self._hand_force(), self.tool)
        violation = self.arm.step()
        if violation is not None:
            self.protective_stop(violation.code, violation.joint)
        self._settle()
        self.state_signals.update()
        self._image.update()

    def _update_scale(self) -> None:
        """Bring the speed scaling towards slider, safety limit and pause."""
        limit = SAFETY_RULES[self.safety_mode].speed_limit
        slider = min(self.outputs["target_speed_fraction"], limit)
        self._speed_slider = ramp(self._speed_slider, slider, self.dt / RAMP_SECONDS)
        self.player.ramp()
        self.arm.scale = self._speed_slider * self.player.pause_factor

    def _settle(self) -> None:
        """Finish transitions that wait for the arm."""
        self.player.settle()
        stopped = self._rule.program is ProgramRule.STOP or not self.arm.enabled
        if stopped and not self.arm.moving and self.arm.target_q != self.arm.actual_q:
            self.arm.hold()
        if self._causes:
            self._release_emergency_stop()

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

    # Power and programs.

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
        return self.robot_mode == RobotMode.RUNNING and self._rule.program is ProgramRule.RUN

    def prepare_script(self, text: str) -> None:
        """Compile a script ahead, in any thread, so that `run_script` need not wait for it."""
        self.player.prepare(text)

    def run_script(self, text: str) -> None:
        """Run a def or sec block, or a single line, from a script port. Errors become messages.

        A def block or a single statement replaces the running program; a sec block runs beside
        it. Panel commands ("power on", "stop program", ...) are obeyed.
        """
        if not self.remote:
            self.post(
                ErrorMessage(
                    _NOT_IN_REMOTE, 0, ReportLevel.WARNING, "Script refused: not in remote control"
                )
            )
            return
        command = _LINE_COMMANDS.get(" ".join(text.split()))
        if command is not None:
            command(self)
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
                self.force_sensor.external = wrench
                self.load_changed()

    # Tool and load.

    def set_tool_communication(self, settings: LineSettings) -> None:
        """Set the serial line to the tool. It takes the wires of the tool's analog inputs."""
        self.tool_communication = settings
        self.signals.connect_tool_analog(not settings.enabled)

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
        if not self._rule.keeps_power:
            return False
        return self._power.up(RobotMode.IDLE, self.time)

    def brake_release(self) -> bool:
        """Release the brakes: IDLE -> RUNNING, powering the arm first where needed."""
        if self._rule.program is ProgramRule.STOP:
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
        if self.runtime_state not in _PLAYABLE or not self.loaded_program:
            return False
        self.player.run(self.programs[self.loaded_program])
        return self.player.loaded

    def pause(self) -> bool:
        """Pause the running program."""
        return self.player.pause()

    def stop(self) -> bool:
        """Stop the program."""
        self.player.end()
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
        self.player.end()
        self._cut_power()
        self._clear(SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.PROTECTIVE_STOP)
        return True

    def load_program(self, name: str) -> bool:
        """Load a stored program; refused while a program runs or when there is none such."""
        if name not in self.programs or self.player.loaded:
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
        """Press the emergency stop button of the robot: a stop of category 1, then no power."""
        self._emergency_pressed = True
        self._emergency_end = self.time + POWER_OFF_SECONDS
        self._cause(SafetyMode.ROBOT_EMERGENCY_STOP)

    def release_emergency_stop(self) -> None:
        """Pull the emergency stop button out again; the arm is left powered off.

        A stop that has begun is completed: until the arm is without power the safety mode stays.
        """
        self._emergency_pressed = False

    def _release_emergency_stop(self) -> None:
        """Leave the safety mode once the button is out and the stop is complete."""
        complete = self.robot_mode == RobotMode.POWER_OFF and self.time >= self._emergency_end
        if complete and not self._emergency_pressed:
            self._clear(SafetyMode.ROBOT_EMERGENCY_STOP)

    def safeguard_stop(self, on: bool) -> None:
        """Open (`on`) or close the safeguard input. The program stays paused until `play`."""
        self._set_cause(SafetyMode.SAFEGUARD_STOP, on)

    def reduced_mode(self, on: bool) -> None:
        """Enter or leave the reduced safety mode."""
        self._set_cause(SafetyMode.REDUCED, on)

    def set_remote(self, on: bool) -> None:
        """Switch between remote and local control; a CB3 controller has no such switch.

        In local control the pendant alone controls the robot: what remote clients run, stops.
        """
        if self.model.is_cb3:
            return
        if not on:
            self.player.end_all()
        self.remote = on

    def violation(self) -> None:
        """Enter the safety mode VIOLATION."""
        self._cause(SafetyMode.VIOLATION)

    def fault(self) -> None:
        """Enter the safety mode FAULT."""
        self._cause(SafetyMode.FAULT)

    def power_loss(self) -> None:
        """Lose the power of the arm without notice; the brakes fall in."""
        self._cut_power()
        self.player.end()
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
            self.player.end(failed=mode in _FAILURES)
        elif rule.program is ProgramRule.PAUSE:
            self.pause()
        if not rule.keeps_power:
            self.power_off()

    def _cut_power(self) -> None:
        self._power.set(RobotMode.POWER_OFF)
        self._power_changed()

    def _power_changed(self) -> None:
        self.arm.enabled = self.robot_mode == RobotMode.RUNNING
        if not self.arm.enabled:
            self.compliance.end()


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
