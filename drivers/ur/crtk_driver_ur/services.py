"""What an arm does beyond CRTK when it is asked to: dashboard commands, and zeroing its force sensor.

None of them takes the control program away from the driver: what would is refused while the arm is under
control. None moves the arm but `play_program`, which starts what somebody has loaded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Final

import numpy as np

from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.models import CB3, RobotModel
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.safety import RobotMode, SafetyMode, name_of
from crtk_drivers.device import Answer, Service, Steps
from crtk_drivers.errors import CommandRefused, Reason, TransitionFailed
from crtk_drivers.samples import Vector, vector

__all__ = ["UrServices"]

AVERAGED: Final = 0.2
"""Seconds of measurements by which a zeroed sensor is checked."""
SETTLED: Final = 0.1
"""Seconds before that, for what was on its way."""
FORCE_TOLERANCE: Final = 5.5
TORQUE_TOLERANCE: Final = 0.6
"""N and N·m that a zeroed sensor may measure: its accuracy (UR10e data sheet: 5.5 N, 0.5 N·m for the
UR3e and UR5e less; 0.6 N·m for larger arms)."""

_BROKEN: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)


class UrServices:
    """The services of one arm.

    Args:
        robot, link, model: of the arm.
        in_control: whether the driver has control of the arm.
        where: the device, for messages.
    """

    def __init__(
        self,
        robot: Robot,
        link: ControlLink,
        model: RobotModel,
        in_control: Callable[[], bool],
        where: str,
    ) -> None:
        self._robot = robot
        self._link = link
        self._model = model
        self._in_control = in_control
        self._where = where
        self.table: Mapping[str, Service] = {
            "unlock_protective_stop": Service(
                "leave a protective stop, 5 s after it at the earliest", self._unlock
            ),
            "restart_safety": Service(
                "restart the safety system after a violation or fault; the arm loses its power",
                self._restart_safety,
            ),
            "power_on": Service("power the arm, with its brakes engaged", self._power_on),
            "brake_release": Service(
                "power the arm and release its brakes", self._brake_release, moves=True
            ),
            "power_off": Service("switch the power of the arm off", self._power_off),
            "close_popup": Service(
                "close the pop-up on the teach pendant", partial(self._close, "close_popup")
            ),
            "close_safety_popup": Service(
                "close the safety pop-up on the teach pendant",
                partial(self._close, "close_safety_popup"),
            ),
            "play_program": Service(
                "start the loaded program, or go on with it where it was paused; it may move the arm",
                self._play,
                moves=True,
                undo=self._end_played,
            ),
            "pause_program": Service(
                "pause the program that runs", partial(self._end, "pause_program"), stops=True
            ),
            "stop_program": Service(
                "stop the program", partial(self._end, "stop_program"), stops=True
            ),
            "shut_down": Service("shut the controller down", self._shut_down),
            "save_log": Service("save the log of the controller", partial(self._tell, "save_log")),
            "zero_force_sensor": Service(
                "make the present load zero, in the arm's force sensor", self._zero_force_sensor
            ),
            "robot_mode": Service("tell the robot mode", self._robot_mode),
            "safety_mode": Service("tell the safety mode", self._safety_mode),
            "program_state": Service(
                "tell the state and name of the program", partial(self._tell, "program_state")
            ),
            "loaded_program": Service(
                "tell which program is loaded", partial(self._tell, "loaded_program")
            ),
            "operational_mode": Service(
                "tell the operational mode", partial(self._tell, "operational_mode")
            ),
            "polyscope_version": Service(
                "tell the version of the software", partial(self._tell, "polyscope_version")
            ),
            "robot_model": Service("tell the model", partial(self._tell, "robot_model")),
            "serial_number": Service(
                "tell the serial number", partial(self._tell, "serial_number")
            ),
        }

    # ------------------------------------------------------------------------------ safety and power

    def _unlock(self) -> Answer:
        if self._robot.safety != SafetyMode.PROTECTIVE_STOP:
            raise self._refusal(
                "unlock_protective_stop", f"the safety mode is {self._safety_name}", ""
            )
        yield from self._robot.require_remote("unlock_protective_stop")
        yield from self._robot.unlock()
        return f"unlocked; the safety mode is {self._safety_name}. Send enable to go on"

    def _restart_safety(self) -> Answer:
        if self._robot.safety not in _BROKEN:
            raise self._refusal(
                "restart_safety",
                f"the safety mode is {self._safety_name}",
                "It is for violations and faults of the safety system only.",
            )
        yield from self._robot.require_remote("restart_safety")
        yield from self._link.ask("close_safety_popup")
        yield from self._link.ask("restart_safety")
        yield from self._robot.until(lambda: self._robot.safety not in _BROKEN)
        return f"restarted; the safety mode is {self._safety_name}. Send enable to go on"

    def _power_on(self) -> Answer:
        yield from self._may_power("power_on")
        yield from self._robot.power_on()
        return self._mode_text

    def _brake_release(self) -> Answer:
        yield from self._may_power("brake_release")
        yield from self._robot.release_brakes()
        return self._mode_text

    def _power_off(self) -> Answer:
        if self._in_control() or self._robot.is_claimed:
            raise self._refusal(
                "power_off",
                "the driver has control of the arm, or is taking it",
                "Send disable, which stops the arm first.",
            )
        yield from self._robot.require_remote("power_off")
        yield from self._robot.power_off()
        return self._mode_text

    def _may_power(self, service: str) -> Steps:
        self._robot.require_safe()
        yield from self._robot.require_remote(service)

    def _close(self, service: str) -> Answer:
        yield from self._robot.require_remote(service)
        yield from self._link.ask(service)
        return "closed"

    # ------------------------------------------------------------------------------------- programs

    def _play(self) -> Answer:
        service = "play_program"
        self._robot.require_hands_off(service)
        self._robot.require_safe()
        yield from self._robot.require_remote(service)
        request = "resume_program" if self._robot.paused else service
        try:
            return str((yield from self._link.ask(request)))
        except GeneratorExit:  # by a stop, and it may have begun
            self._end_played()
            raise

    def _end_played(self) -> None:
        self._link.send("stop_program")

    def _end(self, service: str) -> Answer:
        self._robot.require_hands_off(service)
        yield from self._robot.require_remote(service)
        return str((yield from self._link.ask(service)))

    def _shut_down(self) -> Answer:
        service = "shut_down"
        self._robot.require_hands_off(service)
        yield from self._robot.require_remote(service)
        return str((yield from self._link.ask(service)))

    # --------------------------------------------------------------------------------- force sensor

    def _zero_force_sensor(self) -> Answer:
        service = "zero_force_sensor"
        if self._model.generation is CB3:
            raise CommandRefused(
                service,
                Reason.UNSUPPORTED,
                f"the {self._model.name} has no force sensor; it estimates forces from currents",
                where=self._where,
            )
        if not self._in_control():
            raise CommandRefused(
                service,
                Reason.NOT_ENABLED,
                "the control program does not run",
                where=self._where,
                remedy="Send enable first.",
            )
        if not self._robot.standing:
            raise self._refusal(service, "the arm moves", "Send hold, and wait until it stands.")
        before = yield from self._load()
        yield from self._link.ask("zero_ft_sensor")
        yield from self._robot.until(lambda: False, SETTLED)
        after = yield from self._load()
        force, torque = np.linalg.norm(after[:3]), np.linalg.norm(after[3:])
        if force > FORCE_TOLERANCE or torque > TORQUE_TOLERANCE:
            raise TransitionFailed(
                f"the sensor was zeroed, but measures {_text(after)} after it",
                where=self._where,
                remedy="Let nothing touch the tool and the arm stand, and try again.",
            )
        return f"it measured {_text(before)}; left over {_text(after)}"

    def _load(self) -> Generator[None, None, Vector]:
        """Return the mean of the measured load (6,) over a while."""
        loads: list[tuple[float, ...]] = []
        newest = None
        end = time.monotonic() + AVERAGED
        while time.monotonic() < end or not loads:
            state = self._robot.state
            if state is not None and state is not newest:
                newest = state
                loads.append(state.actual_TCP_force)
            yield
        return vector(np.mean(loads, axis=0))

    # -------------------------------------------------------------------------------------- answers

    def _robot_mode(self) -> Answer:
        yield from ()
        return self._mode_text

    def _safety_mode(self) -> Answer:
        yield from ()
        return self._safety_name

    def _tell(self, request: str) -> Answer:
        text = yield from self._link.ask(request)
        return str(text).strip()

    # --------------------------------------------------------------------------------------- inside

    @property
    def _mode_text(self) -> str:
        return name_of(RobotMode, self._robot.mode)

    @property
    def _safety_name(self) -> str:
        return name_of(SafetyMode, self._robot.safety)

    def _refusal(self, service: str, message: str, remedy: str) -> CommandRefused:
        return CommandRefused(
            service, Reason.INVALID_TRANSITION, message, where=self._where, remedy=remedy
        )


def _text(load: Vector) -> str:
    force = ", ".join(f"{value:.2f}" for value in load[:3].tolist())
    torque = ", ".join(f"{value:.2f}" for value in load[3:].tolist())
    return f"[{force}] N, [{torque}] N·m"
