"""The URScript built-ins that ask or set something of the robot without moving it.

Names, parameters and defaults follow the URScript manual, chapters "internals", "interfaces" and
"motion". Errors are `ScriptRuntimeError`, which stop the program.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from math import isfinite
from typing import TYPE_CHECKING, Any

from crtk_sim_backends.ur import kinematics as k
from crtk_sim_backends.ur.compliance import ForceTask
from crtk_sim_backends.ur.messages import TextMessage
from crtk_sim_backends.ur.motion import six
from crtk_sim_backends.ur.process_image import TORQUE_CONSTANT
from crtk_sim_backends.ur.urscript import Builtin, List, Pose, ScriptRuntimeError, to_text

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

CONTACT_FORCE = 5.0  # N, from which tool_contact reports a contact
WATCHDOG_ACTIONS = ("ignore", "pause", "stop")


def robot_builtins(controller: Controller) -> Iterator[Builtin]:
    """Every built-in of this module for one controller."""
    for group in (_registers, _poses, _state, _kinematics, _tool, _compliance, _io):
        for call in group(controller):
            yield Builtin(call.__name__, call)
    yield Builtin("popup", _popup(controller), blocking=True)


def _vector(name: str, value: Any, length: int) -> tuple[float, ...]:
    if (
        not isinstance(value, (list, tuple))
        or len(value) < length
        or not all(isinstance(x, (int, float)) and isfinite(x) for x in value)
    ):
        raise ScriptRuntimeError(f"{name}: expected {length} finite numbers, got {value}")
    return tuple(float(x) for x in value[:length])


def _registers(c: Controller) -> list[Callable[..., Any]]:
    inputs = c.inputs
    outputs = c.outputs

    def names(template: str, count: int, first: int = 0) -> dict[float, str]:
        return {i: template.format(i) for i in range(first, count)}

    float_in = names("input_double_register_{}", 48)
    int_in = names("input_int_register_{}", 48)
    float_out = names("output_double_register_{}", 48)
    int_out = names("output_int_register_{}", 48)

    def lookup(table: dict[float, str], address: Any) -> str:
        try:
            return table[address]
        except (KeyError, TypeError):
            raise ScriptRuntimeError(f"Register address out of range: {address}") from None

    def read_input_float_register(address: int) -> float:
        return inputs[lookup(float_in, address)]  # type: ignore[no-any-return]

    def read_input_integer_register(address: int) -> int:
        return inputs[lookup(int_in, address)]  # type: ignore[no-any-return]

    def read_output_float_register(address: int) -> float:
        return outputs[lookup(float_out, address)]  # type: ignore[no-any-return]

    def read_output_integer_register(address: int) -> int:
        return outputs[lookup(int_out, address)]  # type: ignore[no-any-return]

    def write_output_float_register(address: int, value: float) -> None:
        outputs[lookup(float_out, address)] = float(value)

    def write_output_integer_register(address: int, value: int) -> None:
        number = int(value)
        if not -(2**31) <= number < 2**31:
            raise ScriptRuntimeError(f"Register value out of range: {value}")
        outputs[lookup(int_out, address)] = number

    def bit(direction: str, address: Any) -> tuple[str, int]:
        if not isinstance(address, (int, float)) or not 0 <= address < 128:
            raise ScriptRuntimeError(f"Register address out of range: {address}")
        index = int(address)
        if index < 64:
            span = "0_to_31" if index < 32 else "32_to_63"
            return f"{direction}_bit_registers{span}", 1 << index % 32
        return f"{direction}_bit_register_{index}", 0

    def read_bit(image: dict[str, Any], direction: str, address: int) -> bool:
        name, mask = bit(direction, address)
        return bool(image[name] & mask if mask else image[name])

    def read_input_boolean_register(address: int) -> bool:
        return read_bit(inputs, "input", address)

    def read_output_boolean_register(address: int) -> bool:
        return read_bit(outputs, "output", address)

    def write_output_boolean_register(address: int, value: bool) -> None:
        name, mask = bit("output", address)
        if not mask:
            outputs[name] = bool(value)
        else:
            outputs[name] = outputs[name] | mask if value else outputs[name] & ~mask

    def rtde_set_watchdog(variable_name: str, min_frequency: float, action: str = "pause") -> None:
        if variable_name not in inputs:
            raise ScriptRuntimeError(f"rtde_set_watchdog: no input variable {variable_name}")
        if action.lower() not in WATCHDOG_ACTIONS:
            raise ScriptRuntimeError(f"rtde_set_watchdog: unknown action {action}")
        c.set_watchdog(variable_name, float(min_frequency), action.lower())

    return [
        read_input_float_register,
        read_input_integer_register,
        read_input_boolean_register,
        read_output_float_register,
        read_output_integer_register,
        read_output_boolean_register,
        write_output_float_register,
        write_output_integer_register,
        write_output_boolean_register,
        rtde_set_watchdog,
    ]


def _poses(_: Controller) -> list[Callable[..., Any]]:
    def pose_trans(p_from: Any, p_from_to: Any) -> Pose:
        return Pose(k.pose_trans(six("pose_trans", p_from), six("pose_trans", p_from_to)))

    def pose_inv(p_from: Any) -> Pose:
        return Pose(k.pose_inv(six("pose_inv", p_from)))

    def pose_add(p_1: Any, p_2: Any) -> Pose:
        return Pose(k.pose_add(six("pose_add", p_1), six("pose_add", p_2)))

    def pose_sub(p_to: Any, p_from: Any) -> Pose:
        return Pose(k.pose_sub(six("pose_sub", p_to), six("pose_sub", p_from)))

    def pose_dist(p_from: Any, p_to: Any) -> float:
        return k.pose_distance(six("pose_dist", p_from), six("pose_dist", p_to))

    def interpolate_pose(p_from: Any, p_to: Any, alpha: float) -> Pose:
        a, b = six("interpolate_pose", p_from), six("interpolate_pose", p_to)
        return Pose(k.interpolate_pose(a, b, alpha))

    return [pose_trans, pose_inv, pose_add, pose_sub, pose_dist, interpolate_pose]


def _state(c: Controller) -> list[Callable[..., Any]]:
    arm = c.arm
    out = c.outputs

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

    def textmsg(s1: Any, s2: Any = "") -> None:
        c.post(TextMessage(to_text(s1) + to_text(s2)))

    def protective_stop() -> None:
        c.protective_stop(209)

    def tool_pose(q: list[float]) -> Pose:
        return Pose(c.kinematics.forward(q, c.tool))

    def twist(qd: list[float]) -> List:
        return List(k.multiply(c.kinematics.jacobian(arm.target_q, c.tool), qd))

    simple: dict[str, Callable[[], Any]] = {
        "get_steptime": lambda: c.dt,
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
        "get_actual_tool_flange_pose": lambda: Pose(c.kinematics.forward(arm.actual_q)),
        "get_target_tool_flange_pose": lambda: Pose(c.kinematics.forward(arm.target_q)),
        "get_target_waypoint": lambda: Pose(c.waypoint) if c.waypoint else tool_pose(arm.target_q),
        "get_joint_torques": lambda: List(
            (actual - target) * constant
            for actual, target, constant in zip(
                out["actual_current"], out["target_current"], TORQUE_CONSTANT, strict=True
            )
        ),
        "get_controller_temp": lambda: 32.0,
        "get_tool_current": lambda: out["tool_output_current"],
        "get_tool_accelerometer_reading": lambda: List(out["actual_tool_accelerometer"]),
        "is_steady": lambda: arm.steady and not c.compliance.active,
    }
    return [
        *(getter(name, read) for name, read in simple.items()),
        get_actual_joint_positions_history,
        get_joint_temp,
        textmsg,
        protective_stop,
    ]


def _popup(c: Controller) -> Callable[..., Any]:
    def popup(
        s: Any,
        title: str = "Popup",
        warning: bool = False,
        error: bool = False,
        blocking: bool = False,
    ) -> Generator[None]:
        c.open_popup(to_text(s), title, warning=bool(warning), error=bool(error))
        while blocking and c.popup_text is not None:
            yield

    return popup


def _kinematics(c: Controller) -> list[Callable[..., Any]]:
    arm = c.arm

    def tool_of(name: str, tcp: Any) -> k.Transform:
        if tcp is None or isinstance(tcp, str):  # "active_tcp"
            return c.tool
        return k.to_transform(six(name, tcp))

    def joints(name: str, q: Any, otherwise: list[float]) -> list[float]:
        return otherwise if q is None or isinstance(q, str) else six(name, q)

    def inverse(x: Any, qnear: Any, tcp: Any) -> list[float] | None:
        near = joints("get_inverse_kin", qnear, arm.target_q)
        pose = six("get_inverse_kin", x)
        return c.kinematics.inverse(k.to_transform(pose), near, tool_of("get_inverse_kin", tcp))

    def get_forward_kin(q: Any = None, tcp: Any = None) -> Pose:
        positions = joints("get_forward_kin", q, arm.actual_q)
        return Pose(c.kinematics.forward(positions, tool_of("get_forward_kin", tcp)))

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
            abs(x) <= limit for x, limit in zip(q, c.model.position, strict=True)
        )

    def get_jacobian(q: Any = None, tcp: Any = None) -> List:
        positions = joints("get_jacobian", q, arm.actual_q)
        matrix = c.kinematics.jacobian(positions, tool_of("get_jacobian", tcp))
        return List(List(row) for row in matrix)

    def get_jacobian_time_derivative(q: Any = None, qd: Any = None, tcp: Any = None) -> List:
        name = "get_jacobian_time_derivative"
        positions = joints(name, q, arm.actual_q)
        speeds = joints(name, qd, arm.actual_qd)
        tool = tool_of(name, tcp)
        h = 1e-5
        before = c.kinematics.jacobian(
            [p - v * h for p, v in zip(positions, speeds, strict=True)], tool
        )
        after = c.kinematics.jacobian(
            [p + v * h for p, v in zip(positions, speeds, strict=True)], tool
        )
        return List(
            List((y - x) / (2 * h) for x, y in zip(rows[0], rows[1], strict=True))
            for rows in zip(before, after, strict=True)
        )

    def get_mass_matrix(q: Any = None, include_rotors_inertia: bool = True) -> List:
        matrix = c.mass_matrix(joints("get_mass_matrix", q, arm.actual_q))
        return List(List(row) for row in matrix)

    def get_coriolis_and_centrifugal_torques(q: Any = None, qd: Any = None) -> List:
        name = "get_coriolis_and_centrifugal_torques"
        positions = joints(name, q, arm.actual_q)
        speeds = joints(name, qd, arm.actual_qd)
        return List(c.dynamics.coriolis(positions, speeds, c.payload, c.payload_cog))

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


def _tool(c: Controller) -> list[Callable[..., Any]]:
    sensor = c.force_sensor

    def set_tcp(pose: Any, tcp_name: str = "") -> None:
        c.set_tcp(tuple(six("set_tcp", pose)))

    def get_tcp_offset() -> Pose:
        return Pose(c.tcp)

    def set_target_payload(
        m: float, cog: Any = None, inertia: Any = None, transition_time: float = 0
    ) -> None:
        if not isfinite(m) or m < 0:
            raise ScriptRuntimeError(f"set_target_payload: payload of {m} kg")
        centre = c.payload_cog if cog is None else _vector("set_target_payload cog", cog, 3)
        tensor = (0.0,) * 6 if inertia is None else _vector("set_target_payload", inertia, 6)
        c.set_payload(float(m), centre, tensor)

    def set_payload(m: float, cog: Any = None) -> None:
        set_target_payload(m, cog, c.payload_inertia)

    def set_payload_mass(m: float) -> None:
        set_payload(m)

    def set_payload_cog(cog: Any) -> None:
        set_payload(c.payload, cog)

    def get_target_payload() -> float:
        return c.payload

    def get_target_payload_cog() -> List:
        return List(c.payload_cog)

    def get_target_payload_inertia() -> List:
        return List(c.payload_inertia)

    def set_gravity(d: Any) -> None:
        c.set_gravity(_vector("set_gravity", d, 3))

    def get_tcp_force() -> List:
        return List(c.outputs["actual_TCP_force"])

    def force() -> float:
        return float(c.outputs["tcp_force_scalar"])

    def zero_ftsensor() -> None:
        sensor.zero()
        c.load_changed()

    def ft_rtde_input_enable(
        enable: bool,
        sensor_mass: float = 0,
        sensor_measuring_offset: Any = None,
        sensor_cog: Any = None,
    ) -> None:
        """Measure with `external_force_torque`, taken to be free of the sensor's own weight."""
        sensor.use_external = bool(enable)
        c.load_changed()

    def enable_external_ft_sensor(
        enable: bool,
        sensor_mass: float = 0,
        sensor_measuring_offset: Any = None,
        sensor_cog: Any = None,
    ) -> None:
        ft_rtde_input_enable(enable)

    def tool_contact(direction: Any = (0.0, 0.0, 0.0)) -> int:
        """Periods since the tool touched something in `direction` (any if zero), 0 if it did not."""
        steps = c.contact_steps()
        way = _vector("tool_contact", direction, 3)
        size = k.norm(way)
        if steps and size > 1e-9:
            opposing = -sum(f * d for f, d in zip(sensor.tcp[:3], way, strict=True)) / size
            if opposing < CONTACT_FORCE:
                return 0
        return steps

    return [
        set_tcp,
        get_tcp_offset,
        set_target_payload,
        set_payload,
        set_payload_mass,
        set_payload_cog,
        get_target_payload,
        get_target_payload_cog,
        get_target_payload_inertia,
        set_gravity,
        get_tcp_force,
        force,
        zero_ftsensor,
        ft_rtde_input_enable,
        enable_external_ft_sensor,
        tool_contact,
    ]


def _compliance(c: Controller) -> list[Callable[..., Any]]:
    compliance = c.compliance

    def force_mode(
        task_frame: Any, selection_vector: Any, wrench: Any, type: int, limits: Any
    ) -> None:
        """Start force mode. `type` 1 and 3 turn the frame; here it is used as given, as with 2."""
        if type not in (1, 2, 3):
            raise ScriptRuntimeError(f"force_mode: unknown type {type}")
        compliance.force_task = ForceTask(
            frame=k.to_transform(six("force_mode task_frame", task_frame)),
            selection=tuple(bool(x) for x in six("force_mode selection_vector", selection_vector)),
            wrench=tuple(six("force_mode wrench", wrench)),
            limits=tuple(abs(x) for x in six("force_mode limits", limits)),
        )

    def end_force_mode() -> None:
        compliance.force_task = None

    def force_mode_set_damping(damping: float) -> None:
        compliance.damping = min(max(float(damping), 0.0), 1.0)

    def force_mode_set_gain_scaling(scaling: float) -> None:
        compliance.gain_scaling = min(max(float(scaling), 0.0), 2.0)

    def freedrive_mode(freeAxes: Any = (1, 1, 1, 1, 1, 1), feature: Any = "base") -> None:  # noqa: N803
        if isinstance(feature, str):
            frame = k.IDENTITY
            if feature == "tool":
                frame = k.compose(c.kinematics.flange(c.arm.target_q), c.tool)
        else:
            frame = k.to_transform(six("freedrive_mode feature", feature))
        compliance.freedrive_frame = frame
        compliance.freedrive_axes = tuple(bool(x) for x in six("freedrive_mode", freeAxes))

    def end_freedrive_mode() -> None:
        compliance.freedrive_axes = None

    def teach_mode() -> None:
        freedrive_mode()

    def end_teach_mode() -> None:
        end_freedrive_mode()

    def get_freedrive_status() -> int:
        """Return 0 when all axes can move, 1 near a singularity, 2 at a joint limit."""
        limits = zip(c.arm.target_q, c.model.position, strict=True)
        if any(abs(q) > limit - 0.01 for q, limit in limits):
            return 2
        return 1 if compliance.near_singularity() else 0

    return [
        force_mode,
        end_force_mode,
        force_mode_set_damping,
        force_mode_set_gain_scaling,
        freedrive_mode,
        end_freedrive_mode,
        teach_mode,
        end_teach_mode,
        get_freedrive_status,
    ]


# Digital signals by kind: first bit, number of signals (RTDE actual_digital_*_bits).
DIGITAL = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2)}


def _io(c: Controller) -> list[Callable[..., Any]]:
    out = c.outputs

    def bit(kind: str, n: Any) -> int:
        first, count = DIGITAL[kind]
        if not isinstance(n, (int, float)) or not 0 <= n < count:
            raise ScriptRuntimeError(f"No {kind} digital signal {n}")
        return first + int(n)

    def reader(name: str, kind: str, image: str) -> Callable[[int], bool]:
        def read(n: int) -> bool:
            return bool(out[image] >> bit(kind, n) & 1)

        read.__name__ = name
        return read

    def writer(name: str, kind: str) -> Callable[[int, bool], None]:
        def write(n: int, b: bool) -> None:
            c.set_digital_outputs(1 << bit(kind, n), (1 << bit(kind, n)) if b else 0)

        write.__name__ = name
        return write

    def set_standard_analog_out(n: int, f: float) -> None:
        if n not in (0, 1) or not 0.0 <= f <= 1.0:
            raise ScriptRuntimeError(f"set_standard_analog_out: channel {n}, value {f}")
        c.set_analog_output(int(n), float(f))

    def set_analog_out(n: int, f: float) -> None:
        set_standard_analog_out(n, f)

    def get_standard_analog_in(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_standard_analog_in: channel {n}")
        return float(out[f"standard_analog_input{int(n)}"])

    def get_standard_analog_out(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_standard_analog_out: channel {n}")
        return float(out[f"standard_analog_output{int(n)}"])

    def get_tool_analog_in(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_tool_analog_in: channel {n}")
        return float(out[f"tool_analog_input{int(n)}"])

    def set_tool_voltage(voltage: int) -> None:
        if voltage not in (0, 12, 24):
            raise ScriptRuntimeError(f"set_tool_voltage: 0, 12 or 24 V, not {voltage}")
        out["tool_output_voltage"] = int(voltage)

    inputs = "actual_digital_input_bits"
    outputs = "actual_digital_output_bits"
    kinds = {"standard": "standard", "configurable": "configurable", "tool": "tool"}
    calls: list[Callable[..., Any]] = []
    for word, kind in kinds.items():
        calls.append(reader(f"get_{word}_digital_in", kind, inputs))
        calls.append(reader(f"get_{word}_digital_out", kind, outputs))
        calls.append(writer(f"set_{word}_digital_out", kind))
    return [
        *calls,
        reader("get_digital_in", "standard", inputs),
        reader("get_digital_out", "standard", outputs),
        writer("set_digital_out", "standard"),
        set_standard_analog_out,
        set_analog_out,
        get_standard_analog_in,
        get_standard_analog_out,
        get_tool_analog_in,
        set_tool_voltage,
    ]
