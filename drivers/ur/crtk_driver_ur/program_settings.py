"""Inputs that the control program carries out: payload, tool, gravity, axes that give way.

A program does not keep them: each new one is told what was given last, or is configured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.frames import PoseVector, Transform
from crtk_driver_ur.inputs import FLANGE, Setting
from crtk_driver_ur.models import model_named
from crtk_driver_ur.plausibility import UPRIGHT, gravity_problem, payload_problem, tilt_problem
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.commands import Payload
from crtk_drivers.device import Note, Severity

__all__ = ["AT_REST", "AXES", "TCP", "ProgramSettings"]

PAYLOAD_MASS: Final = "payload_mass"
PAYLOAD: Final = "payload"
TCP: Final = "tcp"
GRAVITY: Final = "gravity"
AT_REST: Final = (TCP, PAYLOAD, PAYLOAD_MASS, GRAVITY)
"""What the controller must have before the arm moves on."""
FORCE_LIMITS: Final = "force_limits"
FORCE_DAMPING: Final = "force_damping"
FORCE_GAIN: Final = "force_gain"

AXES: Final = ("x", "y", "z", "rx", "ry", "rz")
"""Axes of a frame, and those about them."""

COMPLIANT: Final = {"free": "`free` lets the arm go", "force": "the arm gives way to servo_cf"}
"""Kinds of axes that can be chosen, with what happens along one."""

LARGEST_FORCE_LIMITS: Final = (1.0, 3.0)
"""m/s and rad/s, as in the configuration."""
LONGEST_TOOL: Final = 5.0
"""m from the flange, along each axis."""
PAYLOAD_SIZES: Final = (1, 4, 10)
"""Of numbers: the mass; with the centre of gravity; with the inertia."""
UNIT: Final = 1e-3
"""By which the length of a quaternion may differ from one."""

Request = tuple[str, dict[str, Any]]


class ProgramSettings:
    """Those of one arm. What is given comes from any thread.

    Args:
        robot: reports the present centre of gravity.
        config: what counts before anything is given.
        use_tool: is told each new tool centre point, from any thread.
    """

    def __init__(
        self, robot: Robot, config: UrConfig, use_tool: Callable[[Transform], None]
    ) -> None:
        self._robot = robot
        self._config = config
        self._use_tool = use_tool
        self._model = model_named(config.model)
        self._kept: dict[str, Any] = {}

    def keep(self, name: str, value: Any) -> None:
        """Take note of what was given."""
        if name == PAYLOAD:
            self._kept.pop(PAYLOAD_MASS, None)
        self._kept[name] = value
        if name == TCP:
            self._use_tool(_transform(value))

    def requests(self) -> Iterator[Request]:
        """Yield what a control program that has just started must be told."""
        config = self._config
        if config.tcp is not None or TCP in self._kept:
            yield self._tcp_request()
        gravity = self._kept.get(GRAVITY, config.gravity)
        if gravity is not None:
            yield _gravity(gravity)
        if config.payload is not None or self._kept.keys() & {PAYLOAD, PAYLOAD_MASS}:
            yield self._payload_request()
        if config.control == "native":
            force = config.force
            yield self._chosen_axes("free")
            yield self._chosen_axes("force")
            limits = force.linear_velocity, force.angular_velocity
            yield _force_limits(self._kept.get(FORCE_LIMITS, limits))
            yield _force_damping(self._kept.get(FORCE_DAMPING, force.damping))
            yield _force_gain(self._kept.get(FORCE_GAIN, force.gain))

    def waiting(self) -> Iterator[Note]:
        """Yield what the next program will be told. From any thread."""
        mass = self._kept.get(PAYLOAD_MASS, self._kept.get(PAYLOAD, (None,))[0])
        if mass is not None:
            yield Note(Severity.INFO, PAYLOAD_MASS, f"{mass:g} kg, sent when the arm is enabled")
        if TCP in self._kept:
            yield Note(Severity.INFO, TCP, "sent when the arm is enabled")

    def settings(self) -> Iterator[tuple[str, Setting]]:
        """Yield them by name."""
        largest = self._model.largest_payload
        yield (
            PAYLOAD_MASS,
            Setting(
                "mass of the payload, in kg",
                Payload.NUMBER,
                lambda value: 0.0 <= value <= largest,
                f"a mass from 0 to {largest:g} kg",
                lambda value: self._payload_request(),
                lambda state, value: _has_payload(state, (value,)),
                hint="Is it more than the arm may carry?",
                problem=lambda value: self._payload_problem({PAYLOAD_MASS: value}),
                by_program=True,
                at_rest=True,
            ),
        )
        yield (
            PAYLOAD,
            Setting(
                "payload: mass, kg; centre of gravity from the flange, m (3); inertia about it: xx, yy, "
                "zz, xy, xz, yz, kg m² (6)",
                Payload.NUMBERS,
                lambda value: len(value) in PAYLOAD_SIZES and 0.0 <= value[0] <= largest,
                f"1, 4 or 10 numbers, the first a mass from 0 to {largest:g} kg",
                lambda value: self._payload_request(),
                _has_payload,
                hint="Is it more than the arm may carry?",
                problem=lambda value: self._payload_problem({PAYLOAD: value}),
                by_program=True,
                at_rest=True,
            ),
        )
        yield (
            TCP,
            Setting(
                "tool centre point, from the flange",
                Payload.POSE,
                _is_tool,
                f"a position within {LONGEST_TOOL:g} m of the {FLANGE}, and a unit quaternion",
                lambda value: self._tcp_request(),
                _has_tool,
                hint="The arm's own poses are of another point until it does; send it again.",
                by_program=True,
                at_rest=True,
            ),
        )
        yield (
            GRAVITY,
            Setting(
                "acceleration opposite to gravity in base axes, m/s² (3)",
                Payload.NUMBERS,
                lambda value: len(value) == 3 and not gravity_problem(value),
                "three numbers, together 9.7 to 9.9 m/s²",
                _gravity,
                problem=self._tilt_problem,
                by_program=True,
                at_rest=True,
            ),
        )
        if self._config.control == "native":
            yield from _force_settings()
            for kind in COMPLIANT:
                summary = f"whether the axes along which {COMPLIANT[kind]} are those of the tool"
                yield f"{kind}_of_tool", self._choice(kind, summary)
                for index, axis in enumerate(AXES):
                    about = "along" if index < 3 else "about"
                    summary = f"whether {COMPLIANT[kind]} {about} {AXES[index % 3]}"
                    yield f"{kind}_axis_{axis}", self._choice(kind, summary)

    def _choice(self, kind: str, summary: str) -> Setting:
        return Setting(
            summary,
            Payload.FLAG,
            lambda value: value in (0.0, 1.0),
            "true or false",
            lambda value: self._chosen_axes(kind),
            by_program=True,
        )

    def _chosen_axes(self, kind: str) -> Request:
        """Return the request for all axes of a kind: those that were given, and the configured ones."""
        config, is_free = self._config, kind == "free"
        configured = config.free_axes if is_free else config.force.axes
        frame = config.free_frame if is_free else config.force.frame
        of_tool = self._kept.get(f"{kind}_of_tool", float(frame == "tool"))
        axes = [
            self._kept.get(f"{kind}_axis_{axis}", float(chosen))
            for axis, chosen in zip(AXES, configured, strict=True)
        ]
        return f"set_{kind}_axes", {"axes": axes, "of_tool": of_tool}

    def _tcp_request(self) -> Request:
        pose = self._config.tcp
        if TCP in self._kept:
            pose = _pose_vector(self._kept[TCP])
        assert pose is not None
        return "set_tcp", {"pose": list(pose)}

    def _tilt_problem(self, gravity: Sequence[float]) -> str:
        return tilt_problem(self._kept.get(GRAVITY, self._config.gravity or UPRIGHT), gravity)

    def _payload_problem(self, given: Mapping[str, Any]) -> str:
        """Return why the arm cannot carry what is kept, with what is given now."""
        before = {} if PAYLOAD in given else self._kept
        kept = {**before, **given}
        _, arguments = self._payload_request(kept)
        return payload_problem(
            self._model,
            arguments["mass"],
            arguments["center_of_gravity"],
            arguments.get("inertia"),
        )

    def _payload_request(self, kept: Mapping[str, Any] | None = None) -> Request:
        """Return that for what was given; for what was not, as configured; else the controller's own."""
        kept = self._kept if kept is None else kept
        configured, state = self._config.payload, self._robot.state
        mass, center, inertia = 0.0, state.payload_cog if state is not None else None, None
        if configured is not None:
            mass, center = configured.mass, configured.center_of_gravity
            inertia = configured.inertia
        given = kept.get(PAYLOAD, ())
        if given:
            mass, center = given[0], given[1:4] or center
            inertia = given[4:] or None
        mass = kept.get(PAYLOAD_MASS, mass)
        arguments = {"mass": mass, "center_of_gravity": list(center or (0.0,) * 3)}
        if inertia is None:
            return "set_payload", arguments
        return "set_target_payload", {**arguments, "inertia": list(inertia)}


def _force_settings() -> Iterator[tuple[str, Setting]]:
    fastest, turning = LARGEST_FORCE_LIMITS
    yield (
        FORCE_LIMITS,
        Setting(
            "with which the tool gives way in force mode at most, m/s and rad/s (2)",
            Payload.NUMBERS,
            lambda value: (
                len(value) == 2 and 0.0 < value[0] <= fastest and 0.0 < value[1] <= turning
            ),
            f"two numbers above 0, up to {fastest:g} m/s and {turning:g} rad/s",
            _force_limits,
            by_program=True,
        ),
    )
    for name, summary, largest, request in (
        (
            FORCE_DAMPING,
            "of force mode: 0 goes on when the force ends, 1 stops",
            1.0,
            _force_damping,
        ),
        (FORCE_GAIN, "of the controller's own loop in force mode", 2.0, _force_gain),
    ):
        yield (
            name,
            Setting(
                summary,
                Payload.NUMBER,
                partial(_is_share, largest),
                f"a number from 0 to {largest:g}",
                request,
                by_program=True,
            ),
        )


def _is_share(largest: float, value: float) -> bool:
    return 0.0 <= value <= largest


def _force_limits(value: tuple[float, ...]) -> Request:
    linear, angular = value
    return "set_force_limits", {"linear": linear, "angular": angular}


def _force_damping(value: float) -> Request:
    return "set_force_damping", {"damping": value}


def _force_gain(value: float) -> Request:
    return "set_force_gain", {"gain": value}


def _gravity(value: tuple[float, ...]) -> Request:
    return "set_gravity", {"direction": list(value)}


def _is_tool(value: tuple[float, ...]) -> bool:
    is_unit = abs(math.hypot(*value[3:]) - 1.0) <= UNIT
    return is_unit and all(abs(x) <= LONGEST_TOOL for x in value[:3])


def _transform(value: tuple[float, ...]) -> Transform:
    return Transform.from_quaternion(value[:3], value[3:])


def _pose_vector(value: tuple[float, ...]) -> PoseVector:
    return _transform(value).pose_vector()


def _has_tool(state: StateSample, value: tuple[float, ...]) -> bool:
    if state.tcp_offset is None:
        return True
    return bool(np.allclose(Transform.from_pose_vector(state.tcp_offset), _transform(value)))


def _has_payload(state: StateSample, value: tuple[float, ...]) -> bool:
    reported = (state.payload, *(state.payload_cog or (None,) * 3))
    return all(
        found is None or math.isclose(found, wanted, abs_tol=1e-3)
        for found, wanted in zip(reported, value, strict=False)
    )
