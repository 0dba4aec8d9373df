"""The URScript built-ins for tool and payload, the force sensor, force mode and freedrive.

Names, parameters and defaults follow the URScript manual, chapters "internals" and "motion".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from crtk_sim_backends.ur.motion import kinematics as k
from crtk_sim_backends.ur.motion.compliance import ForceTask, Turning
from crtk_sim_backends.ur.motion.contact import CONTACT_FORCE, Surroundings
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.urscript import Builtin, List, Pose, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import LARGEST, positive, six, vector


def force_builtins(
    plant: Plant,
    surroundings: Surroundings,
    outputs: Mapping[str, Any],
    watch_forces: Callable[[bool], None],
) -> Iterator[Builtin]:
    """Every built-in of this module for one controller.

    Args:
        plant: its mechanics.
        surroundings: what acts on the tool.
        outputs: process image by RTDE output variable name.
        watch_forces: begins or ends to expect forces measured by an RTDE client.
    """
    for call in (*_tool(plant, surroundings, outputs, watch_forces), *_compliance(plant)):
        yield Builtin(call.__name__, call)


def _tool(
    plant: Plant,
    surroundings: Surroundings,
    outputs: Mapping[str, Any],
    watch_forces: Callable[[bool], None],
) -> list[Callable[..., Any]]:
    sensor = plant.force_sensor

    def set_tcp(pose: Any, tcp_name: str = "") -> None:
        plant.set_tcp(tuple(six("set_tcp", pose)))

    def get_tcp_offset() -> Pose:
        return Pose(plant.tcp)

    def set_target_payload(
        m: float, cog: Any = None, inertia: Any = None, transition_time: float = 0
    ) -> None:
        if not 0 <= m <= LARGEST:
            raise ScriptRuntimeError(f"set_target_payload: payload of {m} kg")
        centre = plant.payload_cog if cog is None else vector("set_target_payload cog", cog, 3)
        tensor = (0.0,) * 6 if inertia is None else vector("set_target_payload", inertia, 6)
        plant.set_payload(float(m), centre, tensor)

    def set_payload(m: float, cog: Any = None) -> None:
        set_target_payload(m, cog, plant.payload_inertia)

    def set_payload_mass(m: float) -> None:
        set_payload(m)

    def set_payload_cog(cog: Any) -> None:
        set_payload(plant.payload, cog)

    def get_target_payload() -> float:
        return plant.payload

    def get_target_payload_cog() -> List:
        return List(plant.payload_cog)

    def get_target_payload_inertia() -> List:
        return List(plant.payload_inertia)

    def set_gravity(d: Any) -> None:
        plant.set_gravity(vector("set_gravity", d, 3))

    def get_tcp_force() -> List:
        return List(outputs["actual_TCP_force"])

    def force() -> float:
        return float(outputs["tcp_force_scalar"])

    def zero_ftsensor() -> None:
        sensor.zero()
        plant.load_changed()

    def ft_rtde_input_enable(
        enable: bool,
        sensor_mass: float = 0,
        sensor_measuring_offset: Any = None,
        sensor_cog: Any = None,
    ) -> None:
        """Measure with `external_force_torque`, taken to be free of the sensor's own weight."""
        sensor.use_external = bool(enable)
        watch_forces(bool(enable))
        plant.load_changed()

    def enable_external_ft_sensor(
        enable: bool,
        sensor_mass: float = 0,
        sensor_measuring_offset: Any = None,
        sensor_cog: Any = None,
    ) -> None:
        ft_rtde_input_enable(enable)

    def tool_contact(direction: Any = (0.0, 0.0, 0.0)) -> int:
        """Periods since the tool touched something in `direction` (any if zero), 0 if it did not."""
        steps = surroundings.contact_steps
        way = vector("tool_contact", direction, 3)
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


def _compliance(plant: Plant) -> list[Callable[..., Any]]:
    arm = plant.arm
    compliance = plant.compliance

    def force_mode(
        task_frame: Any, selection_vector: Any, wrench: Any, type: int, limits: Any
    ) -> None:
        """Start force mode; `type` says how the frame turns (`compliance.Turning`)."""
        if type not in (1, 2, 3):
            raise ScriptRuntimeError(f"force_mode: unknown type {type}")
        task = ForceTask(
            frame=k.to_transform(six("force_mode task_frame", task_frame)),
            selection=tuple(bool(x) for x in six("force_mode selection_vector", selection_vector)),
            wrench=tuple(six("force_mode wrench", wrench)),
            limits=tuple(abs(x) for x in six("force_mode limits", limits)),
            turning=Turning(type),
        )
        compliance.start_force(task)

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
                frame = k.compose(plant.kinematics.flange(arm.target_q), plant.tool)
        else:
            frame = k.to_transform(six("freedrive_mode feature", feature))
        axes = tuple(bool(x) for x in six("freedrive_mode", freeAxes))
        compliance.start_freedrive(frame, axes)

    def end_freedrive_mode() -> None:
        compliance.freedrive_axes = None

    def freedrive_mode_no_incorrect_payload_check() -> None:
        freedrive_mode()

    def screw_driving(f: float, v_limit: float) -> None:
        """Press with `f`, N, along the z axis that the tool has now, and follow with `v_limit`, m/s."""
        (force,) = vector("screw_driving f", [f], 1)
        speed = positive("screw_driving v_limit", v_limit)
        frame = k.compose(plant.kinematics.flange(arm.target_q), plant.tool)
        along = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        compliance.start_force(
            ForceTask(
                frame=frame,
                selection=tuple(bool(x) for x in along),
                wrench=tuple(force * x for x in along),
                limits=tuple(speed * x for x in along),
            )
        )

    def end_screw_driving() -> None:
        end_force_mode()

    def teach_mode() -> None:
        freedrive_mode()

    def end_teach_mode() -> None:
        end_freedrive_mode()

    def get_freedrive_status() -> int:
        """Return 0 when all axes can move, 1 near a singularity, 2 at a joint limit."""
        limits = zip(arm.target_q, arm.model.position, strict=True)
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
        freedrive_mode_no_incorrect_payload_check,
        screw_driving,
        end_screw_driving,
        teach_mode,
        end_teach_mode,
        get_freedrive_status,
    ]
