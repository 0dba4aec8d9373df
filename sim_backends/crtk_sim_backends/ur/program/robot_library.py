"""The URScript built-ins that ask for the state of the robot and compute its kinematics.

Names, parameters and defaults follow the URScript manual, chapters "internals" and "motion".
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Iterator
from typing import Any, Protocol

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.messages import Message, TextMessage
from crtk_sim_backends.ur.motion import kinematics as k
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.signals.process_image import TORQUE_CONSTANT
from crtk_sim_backends.ur.urscript import (
    Builtin,
    List,
    Pose,
    ScriptRuntimeError,
    Struct,
    to_text,
)
from crtk_sim_backends.ur.urscript.arguments import six


class Robot(Protocol):
    """What the functions ask and tell.

    Attributes:
        clock: of the controller.
        plant: the mechanics.
        outputs: process image by RTDE output variable name.
        popup_text: text of the open pop-up, or None.
    """

    clock: Clock
    plant: Plant
    outputs: dict[str, Any]
    popup_text: str | None

    @property
    def waypoint(self) -> k.Floats | None:
        """Pose to which the running move goes, None when none runs."""

    def post(self, message: Message) -> None:
        """Send a message to the clients."""

    def protective_stop(self, reason_code: int) -> None:
        """Stop protectively, with an entry `reason_code` in the error log."""

    def open_popup(
        self, text: str, title: str, *, warning: bool, error: bool, blocking: bool
    ) -> None:
        """Show a pop-up on the panel."""


def robot_builtins(robot: Robot) -> Iterator[Builtin]:
    """Every built-in of this module for one robot."""
    for call in (*_state(robot), *_kinematics(robot.plant)):
        yield Builtin(call.__name__, call)
    yield Builtin("popup", _popup(robot), blocking=True)


def _state(robot: Robot) -> list[Callable[..., Any]]:
    clock = robot.clock
    plant = robot.plant
    arm = plant.arm
    out = robot.outputs

    def getter(name: str, read: Callable[[], Any]) -> Callable[[], Any]:
        def get() -> Any:
            return read()

        get.__name__ = name
        return get

    def get_actual_joint_positions_history(steps: int = 0) -> List:
        index = int(steps)
        if not 0 <= index < len(arm.history):
            raise ScriptRuntimeError(f"Joint position history has no step {steps}")
        return List(arm.history[-1 - index])

    def get_joint_temp(j: int) -> float:
        return float(out["joint_temperatures"][int(j)])

    def get_rtde_value(variable_name: str) -> Any:
        """Read an RTDE output by its name."""
        if variable_name not in out:
            raise ScriptRuntimeError(f"get_rtde_value: no variable {variable_name}")
        value = out[variable_name]
        return List(value) if isinstance(value, list | tuple) else value

    def time(mode: int = 0) -> Any:
        """Seconds since the controller started: a number, or with mode 2 a struct (sec, nanosec)."""
        if mode == 0:
            return clock.time
        if mode != 2:
            raise ScriptRuntimeError(f"time: unknown mode {mode}")
        seconds = int(clock.time)
        return Struct((("sec", seconds), ("nanosec", round((clock.time - seconds) * 1e9))))

    def textmsg(s1: Any, s2: Any = "") -> None:
        robot.post(TextMessage(to_text(s1) + to_text(s2)))

    def set_pos(q: Any) -> None:
        """Put an arm that rests to joint positions, as on the vendor's own simulator."""
        positions = six("set_pos", q)
        if any(abs(x) > limit for x, limit in zip(positions, arm.model.position, strict=True)):
            raise ScriptRuntimeError("set_pos: the position is beyond a joint's range")
        if arm.moving:
            raise ScriptRuntimeError("set_pos: the arm moves")
        arm.put(positions)

    def protective_stop() -> None:
        robot.protective_stop(209)

    def tool_pose(q: list[float]) -> Pose:
        return Pose(plant.kinematics.forward(q, plant.tool))

    def twist(qd: list[float]) -> List:
        return List(k.multiply(plant.kinematics.jacobian(arm.target_q, plant.tool), qd))

    simple: dict[str, Callable[[], Any]] = {
        "get_steptime": lambda: clock.dt,
        "get_actual_joint_positions": lambda: List(arm.actual_q),
        "get_joint_positions": lambda: List(arm.actual_q),
        "get_target_joint_positions": lambda: List(arm.target_q),
        "get_actual_joint_speeds": lambda: List(arm.actual_qd),
        "get_joint_speeds": lambda: List(arm.actual_qd),
        "get_target_joint_speeds": lambda: List(arm.target_qd),
        "get_target_joint_accelerations": lambda: List(arm.target_qdd),
        "get_actual_tcp_pose": lambda: tool_pose(arm.actual_q),
        "get_target_tcp_pose": lambda: tool_pose(arm.target_q),
        "get_actual_tcp_speed": lambda: twist(arm.actual_qd),
        "get_target_tcp_speed": lambda: twist(arm.target_qd),
        "get_target_tcp_pose_along_path": lambda: tool_pose(arm.plan_q),
        "get_target_tcp_speed_along_path": lambda: twist([v * arm.scale for v in arm.plan_qd]),
        "get_actual_tool_flange_pose": lambda: Pose(plant.kinematics.forward(arm.actual_q)),
        "get_target_tool_flange_pose": lambda: Pose(plant.kinematics.forward(arm.target_q)),
        "get_target_waypoint": lambda: (
            Pose(robot.waypoint) if robot.waypoint else tool_pose(arm.target_q)
        ),
        "get_joint_torques": lambda: List(
            (actual - target) * constant
            for actual, target, constant in zip(
                out["actual_current"], out["target_current"], TORQUE_CONSTANT, strict=True
            )
        ),
        "get_controller_temp": lambda: 32.0,
        "get_tool_current": lambda: out["tool_output_current"],
        "get_tool_accelerometer_reading": lambda: List(out["actual_tool_accelerometer"]),
        "get_gravity": lambda: List(plant.gravity),
        "get_tool_temp": lambda: out["tool_temperature"],
        "random": random.Random(0).random,  # the same numbers in each run of the simulator
        "is_steady": lambda: arm.steady and not plant.compliance.active,
    }
    return [
        *(getter(name, read) for name, read in simple.items()),
        get_actual_joint_positions_history,
        get_joint_temp,
        get_rtde_value,
        time,
        textmsg,
        set_pos,
        protective_stop,
    ]


def _popup(robot: Robot) -> Callable[..., Any]:
    def popup(
        s: Any,
        title: str = "Popup",
        warning: bool = False,
        error: bool = False,
        blocking: bool = False,
    ) -> Generator[None]:
        kind = {"warning": bool(warning), "error": bool(error), "blocking": bool(blocking)}
        robot.open_popup(to_text(s), title, **kind)
        while blocking and robot.popup_text is not None:
            yield

    return popup


def _kinematics(plant: Plant) -> list[Callable[..., Any]]:
    arm = plant.arm

    def tool_of(name: str, tcp: Any) -> k.Transform:
        if tcp is None or isinstance(tcp, str):  # "active_tcp"
            return plant.tool
        return k.to_transform(six(name, tcp))

    def joints(name: str, q: Any, otherwise: list[float]) -> list[float]:
        return otherwise if q is None or isinstance(q, str) else six(name, q)

    def inverse(x: Any, qnear: Any, tcp: Any) -> list[float] | None:
        near = joints("get_inverse_kin", qnear, arm.target_q)
        pose = six("get_inverse_kin", x)
        return plant.kinematics.inverse(k.to_transform(pose), near, tool_of("get_inverse_kin", tcp))

    def get_forward_kin(q: Any = None, tcp: Any = None) -> Pose:
        positions = joints("get_forward_kin", q, arm.actual_q)
        return Pose(plant.kinematics.forward(positions, tool_of("get_forward_kin", tcp)))

    def get_inverse_kin(
        x: Any,
        qnear: Any = None,
        maxPositionError: float = 1e-10,  # noqa: N803
        maxOrientationError: float = 1e-10,  # noqa: N803
        tcp: Any = None,
    ) -> List:
        q = inverse(x, qnear, tcp)
        if q is None:
            raise ScriptRuntimeError("get_inverse_kin: Unable to find a solution")
        return List(q)

    def get_inverse_kin_has_solution(
        x: Any,
        qnear: Any = None,
        maxPositionError: float = 1e-10,  # noqa: N803
        maxOrientationError: float = 1e-10,  # noqa: N803
        tcp: Any = None,
    ) -> bool:
        return inverse(x, qnear, tcp) is not None

    def is_within_safety_limits(pose: Any) -> bool:
        q = inverse(pose, None, None) if isinstance(pose, Pose) else six("pose", pose)
        return q is not None and all(
            abs(x) <= limit for x, limit in zip(q, arm.model.position, strict=True)
        )

    def get_jacobian(q: Any = None, tcp: Any = None) -> List:
        positions = joints("get_jacobian", q, arm.actual_q)
        matrix = plant.kinematics.jacobian(positions, tool_of("get_jacobian", tcp))
        return List(List(row) for row in matrix)

    def get_jacobian_time_derivative(q: Any = None, qd: Any = None, tcp: Any = None) -> List:
        name = "get_jacobian_time_derivative"
        positions = joints(name, q, arm.actual_q)
        speeds = joints(name, qd, arm.actual_qd)
        tool = tool_of(name, tcp)
        h = 1e-5
        before = plant.kinematics.jacobian(
            [p - v * h for p, v in zip(positions, speeds, strict=True)], tool
        )
        after = plant.kinematics.jacobian(
            [p + v * h for p, v in zip(positions, speeds, strict=True)], tool
        )
        return List(
            List((y - x) / (2 * h) for x, y in zip(rows[0], rows[1], strict=True))
            for rows in zip(before, after, strict=True)
        )

    def get_mass_matrix(q: Any = None, include_rotors_inertia: bool = True) -> List:
        positions = joints("get_mass_matrix", q, arm.actual_q)
        matrix = plant.mass_matrix(positions, bool(include_rotors_inertia))
        return List(List(row) for row in matrix)

    def get_coriolis_and_centrifugal_torques(q: Any = None, qd: Any = None) -> List:
        name = "get_coriolis_and_centrifugal_torques"
        positions = joints(name, q, arm.actual_q)
        speeds = joints(name, qd, arm.actual_qd)
        return List(plant.coriolis(positions, speeds))

    return [
        get_forward_kin,
        get_inverse_kin,
        get_inverse_kin_has_solution,
        is_within_safety_limits,
        get_jacobian,
        get_jacobian_time_derivative,
        get_mass_matrix,
        get_coriolis_and_centrifugal_torques,
    ]
