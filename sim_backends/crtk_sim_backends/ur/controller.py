"""The simulated controller: one control period per `tick`, without sockets and without a clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from crtk_sim_backends.ur.messages import Message
from crtk_sim_backends.ur.safety import RobotMode, RuntimeState, SafetyMode

if TYPE_CHECKING:
    from crtk_sim_backends.ur.models import RobotModel
    from crtk_sim_backends.ur.urscript import Builtin


def no_builtins(controller: Controller) -> Iterable[Builtin]:
    """Add nothing to the built-ins of a controller."""
    return ()


class Controller:
    """One robot and its controller in virtual time. Not thread-safe: one thread drives it.

    Args:
        model: arm, from `models.MODELS`.
        version: software version (major, minor, bugfix, build).
        powered_on: start in RUNNING with the brakes released, else in POWER_OFF.
        remote: start in remote control.
        extra_builtins: URScript built-ins to add (the socket functions of `script_sockets`).
    """

    dt: float  # control period, s: 1/500 (e-Series and later) or 1/125 (CB3)
    tick_count: int
    time: float  # s since start; advances in tick() alone
    outputs: dict[str, Any]  # process image by RTDE output variable name, valid after each tick()
    inputs: dict[str, Any]  # by RTDE input variable name
    remote: bool
    operational_mode: str  # "NONE", "MANUAL" or "AUTOMATIC"
    popup_text: str | None
    loaded_program: str  # "" when none
    program_name: str  # of the running (or last) program, "" before the first
    robot_mode: RobotMode
    safety_mode: SafetyMode
    runtime_state: RuntimeState

    def __init__(
        self,
        model: RobotModel,
        version: tuple[int, int, int, int],
        *,
        powered_on: bool = True,
        remote: bool = True,
        extra_builtins: Callable[[Controller], Iterable[Builtin]] = no_builtins,
    ) -> None:
        raise NotImplementedError

    def tick(self) -> None:
        """Advance one control period."""
        raise NotImplementedError

    def run_script(self, text: str) -> None:
        """Run a def or sec block, or a single line, from a script port. Errors become messages."""
        raise NotImplementedError

    def write_inputs(self, values: Mapping[str, Any]) -> None:
        """Take one RTDE input package: values by input variable name."""
        raise NotImplementedError

    def take_messages(self) -> list[Message]:
        """Messages since the last call, oldest first."""
        raise NotImplementedError

    # Panel and dashboard: each True when accepted, False when refused in the present state.

    def power_on(self) -> bool:
        """Power the arm: POWER_OFF -> POWER_ON -> IDLE."""
        raise NotImplementedError

    def power_off(self) -> bool:
        """Stop the program and cut the power of the arm."""
        raise NotImplementedError

    def brake_release(self) -> bool:
        """Release the brakes: IDLE -> RUNNING, powering the arm first where needed."""
        raise NotImplementedError

    def play(self) -> bool:
        """Start the loaded program, or resume the paused one."""
        raise NotImplementedError

    def pause(self) -> bool:
        """Pause the running program."""
        raise NotImplementedError

    def stop(self) -> bool:
        """Stop the program."""
        raise NotImplementedError

    def unlock_protective_stop(self) -> bool:
        """Leave a protective stop. Refused in its first 5 s."""
        raise NotImplementedError

    def restart_safety(self) -> bool:
        """Leave a violation or fault; the arm is powered off afterwards."""
        raise NotImplementedError

    def open_popup(self, text: str, title: str = "") -> None:
        """Show a pop-up on the panel."""
        raise NotImplementedError

    def close_popup(self) -> bool:
        """Close the pop-up; a program that waits on it goes on."""
        raise NotImplementedError

    def load_program(self, name: str) -> bool:
        """Load a stored program; refused while a program runs or when there is none such."""
        raise NotImplementedError

    def set_operational_mode(self, mode: str) -> bool:
        """Set "MANUAL" or "AUTOMATIC", or give the choice back to the panel with "NONE"."""
        raise NotImplementedError

    # What happens to a robot.

    def protective_stop(self, reason_code: int = 158) -> None:
        """Stop protectively, with an entry `reason_code` in the error log."""
        raise NotImplementedError

    def emergency_stop(self) -> None:
        """Press the emergency stop button of the robot."""
        raise NotImplementedError

    def release_emergency_stop(self) -> None:
        """Pull the emergency stop button out again; the arm is left powered off."""
        raise NotImplementedError

    def safeguard_stop(self, on: bool) -> None:
        """Open (`on`) or close the safeguard input."""
        raise NotImplementedError

    def reduced_mode(self, on: bool) -> None:
        """Enter or leave the reduced safety mode."""
        raise NotImplementedError

    def set_remote(self, on: bool) -> None:
        """Switch between remote and local control."""
        raise NotImplementedError

    def violation(self) -> None:
        """Enter the safety mode VIOLATION."""
        raise NotImplementedError

    def fault(self) -> None:
        """Enter the safety mode FAULT."""
        raise NotImplementedError

    def power_loss(self) -> None:
        """Lose the power of the arm without notice."""
        raise NotImplementedError

    def freeze_joint(self, index: int, on: bool = True) -> None:
        """Block joint `index` (0 to 5) mechanically, or free it again."""
        raise NotImplementedError

    def external_force(self, wrench: Sequence[float]) -> None:
        """Push with `wrench` (fx fy fz N, tx ty tz N.m) at the TCP, in the axes of the base."""
        raise NotImplementedError
