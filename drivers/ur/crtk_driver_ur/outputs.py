"""What an arm can be told beyond CRTK: speed slider, payload, compliance, outputs of control box and tool.

A value is checked and kept by whoever gives it, and sent by the I/O thread: of each input the newest,
one request to the control process at a time. What the controller reports afterwards is compared with
it, for it tells nobody when it does not take a value.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.rtde.stream import StateSample
from crtk_drivers.commands import Payload
from crtk_drivers.device import Input, Note, Severity, Steps
from crtk_drivers.errors import CommandRefused, DeviceError, Reason

__all__ = ["UrInputs"]

TAKEN_WITHIN: Final = 1.0
"""Seconds after which the controller must report what it was told."""

DIGITAL: Final = {
    "digital_out": ("standard", 0, 8),
    "configurable_out": ("configurable", 8, 8),
    "tool_out": ("tool", 16, 2),
}
"""Kinds of digital outputs: name in RTDE, first bit of `actual_digital_output_bits`, number."""

ANALOG: Final = {"voltage": (1, 0.0, 10.0, "V"), "current": (0, 0.004, 0.020, "A")}
"""Kinds of analog outputs: bit of `standard_analog_output_type`, range, unit."""

PAYLOAD_MASS: Final = "payload_mass"

AXES: Final = ("x", "y", "z", "rx", "ry", "rz")
"""Axes of the base frame, and those about them."""

COMPLIANT: Final = {"free": "`free` lets the arm go", "force": "the arm gives way to servo_cf"}
"""Kinds of axes that can be chosen, with what happens along one."""

TOOL_VOLTAGES: Final = (0.0, 12.0, 24.0)
LARGEST_PAYLOAD: Final = 100.0
"""kg; each controller knows its own limit."""

_NOT_TAKEN: Final = "the controller does not report it. "


@dataclass(frozen=True)
class _Setting:
    """One input.

    Attributes:
        summary: one line for people.
        payload: number or flag.
        allowed: says whether a number may be sent.
        range: in words.
        request: to the control process, for a value: name and arguments.
        reported: whether a state of the controller agrees with a value; also if it does not tell.
        hint: what to do if it never does.
        by_program: it is set by the control program, which must run.
    """

    summary: str
    payload: Payload
    allowed: Callable[[float], bool]
    range: str
    request: Callable[[float], tuple[str, dict[str, Any]]]
    reported: Callable[[StateSample, float], bool]
    hint: str = ""
    by_program: bool = False


class UrInputs:
    """The inputs of one arm. `table` may be used from any thread, the rest belongs to the I/O thread.

    Args:
        robot, link: of the arm.
        config: what counts before anything is given.
        in_control: whether the control program runs.
        where: the device, for messages.
    """

    def __init__(
        self,
        robot: Robot,
        link: ControlLink,
        config: UrConfig,
        in_control: Callable[[], bool],
        where: str,
    ) -> None:
        self._robot = robot
        self._link = link
        self._config = config
        self._in_control = in_control
        self._where = where
        self._settings = dict(self._all())
        self._lock = threading.Lock()
        self._given: dict[str, float] = {}
        self._kept: dict[str, float] = {}  # what the control program was told, or is to be
        self._sending: Steps | None = None
        self._checking: dict[str, tuple[float, float]] = {}  # value, until when it may take
        self._problems: dict[str, str] = {}
        self.table: Mapping[str, Input] = {
            name: Input(setting.summary, setting.payload, partial(self._take, name))
            for name, setting in self._settings.items()
        }

    def reset(self) -> None:
        """Forget what was not sent yet: it was meant for a connection that is gone."""
        with self._lock:
            self._given.clear()
        self._sending = None
        self._checking.clear()
        self._problems.clear()

    def step(self) -> None:
        """Send what was given, and compare what the controller reports. Once a cycle."""
        if self._sending is None and self._given:
            self._sending = self._send()
        if self._sending is not None:
            try:
                next(self._sending)
            except StopIteration:
                self._sending = None
        if self._checking:
            self._check(time.monotonic())

    def notes(self) -> Iterator[Note]:
        """Yield what could not be set. From any thread."""
        for name, problem in list(self._problems.items()):
            yield Note(Severity.WARNING, name, problem)
        mass = self._kept.get(PAYLOAD_MASS)
        if mass is not None and not self._in_control():
            yield Note(Severity.INFO, PAYLOAD_MASS, f"{mass:g} kg, sent when the arm is enabled")

    def program_requests(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield what a control program that has just started must be told: requests and arguments."""
        config = self._config
        mass = self._kept.get(PAYLOAD_MASS)
        if mass is None and config.payload is not None:
            mass = config.payload.mass
        if mass is not None:
            yield self._payload(mass)
        if config.control == "native":
            force = config.force
            yield self._chosen_axes("free")
            yield self._chosen_axes("force")
            linear, angular = force.linear_velocity, force.angular_velocity
            yield "set_force_limits", {"linear": linear, "angular": angular}
            yield "set_force_damping", {"damping": force.damping}
            yield "set_force_gain", {"gain": force.gain}

    # -------------------------------------------------------------------------------------- inside

    def _take(self, name: str, given: Any) -> None:
        """Check and keep one value (a `Number` or a `Flag`)."""
        setting = self._settings[name]
        value = float(given.value)
        if not math.isfinite(value):
            raise CommandRefused(
                name, Reason.NOT_FINITE, "not finite", remedy=f"Send {setting.range}."
            )
        if not setting.allowed(value):
            raise CommandRefused(
                name,
                Reason.OUT_OF_RANGE,
                f"{value:g} is not allowed",
                remedy=f"Send {setting.range}.",
            )
        if self._robot.state is None:
            raise CommandRefused(
                name, Reason.NOT_CONNECTED, "not connected", remedy="Send it again later."
            )
        with self._lock:
            self._given[name] = value
            if setting.by_program:
                self._kept[name] = value

    def _send(self) -> Steps:
        with self._lock:
            ready = [
                name
                for name in self._given
                if self._in_control() or not self._settings[name].by_program
            ]
            batch = {name: self._given.pop(name) for name in ready}
        for name, value in batch.items():
            request, arguments = self._settings[name].request(value)
            try:
                yield from self._link.ask(request, **arguments)
            except DeviceError as error:
                self._checking.pop(name, None)
                self._problems[name] = f"{error.message}. {error.remedy}"
            else:
                self._checking[name] = value, time.monotonic() + TAKEN_WITHIN

    def _check(self, now: float) -> None:
        state = self._robot.state
        for name, (value, until) in list(self._checking.items()):
            setting = self._settings[name]
            if state is not None and setting.reported(state, value):
                del self._checking[name]
                self._problems.pop(name, None)
            elif now > until:
                del self._checking[name]
                self._problems[name] = f"set to {value:g}, but {_NOT_TAKEN}{setting.hint}"

    def _all(self) -> Iterator[tuple[str, _Setting]]:
        yield (
            "speed_slider",
            _Setting(
                "share of their speed at which programs run, 0 to 1",
                Payload.NUMBER,
                lambda value: 0.0 <= value <= 1.0,
                "a number from 0 to 1",
                lambda value: _inputs(speed_slider_mask=1, speed_slider_fraction=value),
                lambda state, value: math.isclose(state.target_speed_fraction, value, abs_tol=0.01),
                "Is the slider locked on the teach pendant?",
            ),
        )
        yield (
            PAYLOAD_MASS,
            _Setting(
                "mass of the payload, in kg",
                Payload.NUMBER,
                lambda value: 0.0 <= value <= LARGEST_PAYLOAD,
                f"a mass from 0 to {LARGEST_PAYLOAD:g} kg",
                self._payload,
                lambda state, value: (
                    state.payload is None or math.isclose(state.payload, value, abs_tol=1e-3)
                ),
                "Is it more than the arm may carry?",
                by_program=True,
            ),
        )
        yield (
            "tool_voltage",
            _Setting(
                "supply voltage of the tool connector: 0, 12 or 24 V",
                Payload.NUMBER,
                TOOL_VOLTAGES.__contains__,
                "0, 12 or 24",
                lambda value: ("set_tool_voltage", {"voltage": int(value)}),
                lambda state, value: state.tool_output_voltage in (None, value),
                "Is the tool connector controlled by a URCap, or the arm without power?",
            ),
        )
        for name, (kind, first, count) in DIGITAL.items():
            for pin in range(count):
                yield f"{name}_{pin}", _digital(kind, first + pin, pin)
        for kind, (domain, low, high, unit) in ANALOG.items():
            for channel in (0, 1):
                name = f"analog_out_{channel}_{kind}"
                yield name, _analog(channel, kind, domain, low, high, unit)

        if self._config.control == "native":
            for kind in COMPLIANT:
                for index, axis in enumerate(AXES):
                    yield f"{kind}_axis_{axis}", self._axis(kind, index)

    def _axis(self, kind: str, index: int) -> _Setting:
        about = "along" if index < 3 else "about"
        return _Setting(
            f"{COMPLIANT[kind]} {about} {AXES[index % 3]} of the base",
            Payload.FLAG,
            lambda value: value in (0.0, 1.0),
            "true or false",
            lambda value: self._chosen_axes(kind),
            lambda state, value: True,
            by_program=True,
        )

    def _chosen_axes(self, kind: str) -> tuple[str, dict[str, Any]]:
        """Return the request for all axes of a kind: those that were given, and the configured ones."""
        configured = self._config.free_axes if kind == "free" else self._config.force.axes
        axes = [
            self._kept.get(f"{kind}_axis_{axis}", float(chosen))
            for axis, chosen in zip(AXES, configured, strict=True)
        ]
        return f"set_{kind}_axes", {"axes": axes}

    def _payload(self, mass: float) -> tuple[str, dict[str, Any]]:
        configured, state = self._config.payload, self._robot.state
        center = configured.center_of_gravity if configured is not None else None
        reported = state.payload_cog if state is not None else None
        arguments = {"mass": mass, "center_of_gravity": list(center or reported or (0.0,) * 3)}
        if configured is None or configured.inertia is None:
            return "set_payload", arguments
        return "set_target_payload", {**arguments, "inertia": list(configured.inertia)}


def _inputs(**values: float) -> tuple[str, dict[str, Any]]:
    return "write_inputs", {"values": values}


def _digital(kind: str, bit: int, pin: int) -> _Setting:
    def request(value: float) -> tuple[str, dict[str, Any]]:
        name = f"{kind}_digital_output"
        return _inputs(**{f"{name}_mask": 1 << pin, name: int(value) << pin})

    def reported(state: StateSample, value: float) -> bool:
        bits = state.actual_digital_output_bits
        return bits is None or bits >> bit & 1 == value

    return _Setting(
        f"{kind} digital output {pin}",
        Payload.FLAG,
        lambda value: value in (0.0, 1.0),
        "true or false",
        request,
        reported,
        "Is it assigned to a function in the controller's installation?",
    )


def _analog(channel: int, kind: str, domain: int, low: float, high: float, unit: str) -> _Setting:
    def request(value: float) -> tuple[str, dict[str, Any]]:
        ratios = {f"standard_analog_output_{other}": 0.0 for other in (0, 1)}
        ratios[f"standard_analog_output_{channel}"] = (value - low) / (high - low)
        return _inputs(
            standard_analog_output_mask=1 << channel,
            standard_analog_output_type=domain << channel,
            **ratios,
        )

    def reported(state: StateSample, value: float) -> bool:
        present = (state.standard_analog_output0, state.standard_analog_output1)[channel]
        return present is None or math.isclose(present, value, abs_tol=0.01 * (high - low))

    return _Setting(
        f"{kind} of analog output {channel}, {low:g} to {high:g} {unit}",
        Payload.NUMBER,
        lambda value: low <= value <= high,
        f"a number from {low:g} to {high:g} {unit}",
        request,
        reported,
        "Is it assigned to a function in the controller's installation?",
    )
