"""What the controller reports beside motion, as typed values: signals, modes, stops, payload, program."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from functools import partial
from typing import Any, Final

from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.frames import Transform
from crtk_driver_ur.inputs import FLANGE
from crtk_driver_ur.reports import ANALOG, DIGITAL
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import RobotMode, RuntimeState, SafetyMode, SafetyStatus, name_of
from crtk_drivers.commands import Payload
from crtk_drivers.device import Reading
from crtk_drivers.samples import Flag, Number, Numbers, Pose, Text, Value, vector

__all__ = ["UrReadings"]

MODES: Final = {
    "robot_mode": ("of the arm: POWER_OFF, IDLE, RUNNING, ...", RobotMode, "robot_mode"),
    "safety_mode": ("of the safety system: NORMAL, ...", SafetyMode, "safety_mode"),
    "program": ("of any program: STOPPED, PLAYING, PAUSED, ...", RuntimeState, "runtime_state"),
}

STOPS: Final = {
    "protective_stop": SafetyStatus.PROTECTIVE_STOPPED,
    "safeguard_stop": SafetyStatus.SAFEGUARD_STOPPED,
    "emergency_stop": SafetyStatus.EMERGENCY_STOPPED,
    "robot_emergency_stop": SafetyStatus.ROBOT_EMERGENCY_STOPPED,
    "system_emergency_stop": SafetyStatus.SYSTEM_EMERGENCY_STOPPED,
    "safety_violation": SafetyStatus.VIOLATION,
    "safety_fault": SafetyStatus.FAULT,
}
"""Bits of `safety_status_bits`."""

NUMBERS: Final = {
    "speed_slider": ("of the speed slider, 0 to 1", "target_speed_fraction"),
    "speed_scaling": (
        "share of its speed at which the program runs, 0 to 1",
        "combined_speed_scaling",
    ),
    "payload_mass": ("of the payload, kg", "payload"),
    "tool_voltage": ("supply of the tool connector, V", "tool_output_voltage"),
    "tool_current": ("that the tool takes, A", "tool_output_current"),
}


class UrReadings:
    """The readings of one arm. From any thread.

    Args:
        robot, link: of the arm.
    """

    def __init__(self, robot: Robot, link: ControlLink) -> None:
        self._robot = robot
        self._link = link
        self._tool: tuple[tuple[float, ...], Pose] | None = None
        self.table: Mapping[str, Reading] = dict(self._all())

    def _all(self) -> Iterator[tuple[str, Reading]]:
        for way, bits in (
            ("in", "actual_digital_input_bits"),
            ("out", "actual_digital_output_bits"),
        ):
            for kind, (first, count) in DIGITAL.items():
                for pin in range(count):
                    summary = f"whether {kind} {way}put {pin} is on".replace("  ", " ")
                    yield (
                        f"{kind or 'digital'}_{way}_{pin}",
                        self._of(summary, Payload.FLAG, _bit(bits, first + pin)),
                    )
        for name, (field, kinds, bit) in ANALOG.items():
            for unit, is_voltage in (("voltage", True), ("current", False)):
                summary = f"{unit} of {name}, {'V' if is_voltage else 'A'}"
                tell = partial(_analog, field, kinds, bit, is_voltage)
                yield f"{name}_{unit}".replace(" ", "_"), self._of(summary, Payload.NUMBER, tell)
        for name, (summary, modes, field) in MODES.items():
            yield name, self._of(f"mode {summary}", Payload.TEXT, partial(_mode, modes, field))
        for name, stop in STOPS.items():
            summary = f"whether the safety system reports: {name.replace('_', ' ')}"
            yield name, self._of(summary, Payload.FLAG, partial(_stopped, stop))
        for name, (summary, field) in NUMBERS.items():
            yield name, self._of(summary, Payload.NUMBER, partial(_number, field))
        yield (
            "payload",
            self._of("mass, kg, and centre of gravity, m", Payload.NUMBERS, _payload),
        )
        yield "tcp", self._of(f"tool centre point, from the {FLANGE}", Payload.POSE, self._tcp)
        yield (
            "program_running",
            self._of(
                "whether a program runs, the driver's own included",
                Payload.FLAG,
                lambda state: Flag(state.runtime_state == RuntimeState.PLAYING),
            ),
        )
        yield (
            "remote_control",
            Reading(
                "whether it is in remote control", Payload.FLAG, lambda: self._known(Flag, "remote")
            ),
        )
        yield (
            "loaded_program",
            Reading(
                "which program is loaded; empty if none is",
                Payload.TEXT,
                lambda: self._known(Text, "loaded_program"),
            ),
        )

    def _of(
        self, summary: str, payload: Payload, tell: Callable[[StateSample], Value | None]
    ) -> Reading:
        def told() -> Value | None:
            state = self._robot.state
            return None if state is None else tell(state)

        return Reading(summary, payload, told)

    def _known(self, kind: Callable[[Any], Value], name: str) -> Value | None:
        value = getattr(self._link, name)
        return None if value is None or self._robot.state is None else kind(value)

    def _tcp(self, state: StateSample) -> Pose | None:
        offset = state.tcp_offset
        if offset is None:
            return None
        if self._tool is None or self._tool[0] != offset:
            tool = Transform.from_pose_vector(offset)
            pose = Pose(vector(tool.position), vector(tool.quaternion()), FLANGE)
            self._tool = offset, pose
        return self._tool[1]


def _bit(field: str, bit: int) -> Callable[[StateSample], Flag | None]:
    def tell(state: StateSample) -> Flag | None:
        bits = getattr(state, field)
        return None if bits is None else Flag(bool(bits >> bit & 1))

    return tell


def _analog(
    field: str, kinds: str, bit: int, is_voltage: bool, state: StateSample
) -> Number | None:
    """Return it if the signal is of that kind now."""
    value, found = getattr(state, field), getattr(state, kinds)
    if value is None or found is None or bool(found >> bit & 1) is not is_voltage:
        return None
    return Number(value)


def _mode(modes: type[IntEnum], field: str, state: StateSample) -> Text:
    return Text(name_of(modes, getattr(state, field)))


def _stopped(stop: SafetyStatus, state: StateSample) -> Flag:
    return Flag(bool(state.safety_status_bits & stop))


def _number(field: str, state: StateSample) -> Number | None:
    value = getattr(state, field)
    return None if value is None else Number(float(value))


def _payload(state: StateSample) -> Numbers | None:
    if state.payload is None or state.payload_cog is None:
        return None
    return Numbers((state.payload, *state.payload_cog))
