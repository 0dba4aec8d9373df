"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any, Final

from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import MissingExtra
from crtk_drivers.plugins import DevicePlugin, RunningSim, required
from crtk_drivers.ros import environment

_SIMULATED: Final[Mapping[str, Any]] = {
    "position_controller": "forward_position_controller",
    "velocity_controller": "forward_velocity_controller",
    "effort_controller": "forward_effort_controller",
    "trajectory_controller": "joint_trajectory_controller",
    "allow_untimed": True,
}
"""Controllers of the simulator, for who names none: nobody is hurt by it."""


def _create(config: Ros2ControlConfig) -> Device:
    for library in ("rclpy", "control_msgs", "controller_manager_msgs", "lifecycle_msgs"):
        if find_spec(library) is None:
            raise MissingExtra(library, "ros2-control")
    environment.check()
    environment.share_no_memory()
    from crtk_driver_ros2_control.device import Ros2ControlDevice

    return Ros2ControlDevice(config)


def _at_sim(config: Ros2ControlConfig, sim: RunningSim) -> Ros2ControlConfig:
    namespace = sim.control.status()["namespace"]
    values: dict[str, Any] = {
        "controller_manager": f"{namespace}/controller_manager",
        "joint_states": f"{namespace}/joint_states",
    }
    if not config.joints and config.urdf is None:
        values["joints"] = sim.control.call("joint_limits")
    if not any(config.controllers):
        values.update(_SIMULATED)
    given = config.model_dump(exclude_unset=True)
    return Ros2ControlConfig(**{**given, **values})


def _sim_options(config: Ros2ControlConfig) -> Mapping[str, Any]:
    options: dict[str, Any] = {"rate": config.rate}
    if config.joints:
        options["joints"] = ",".join(joint.name for joint in config.joints)
    elif config.urdf is not None:
        from crtk_driver_ros2_control.arm import load_arm

        options["joints"] = ",".join(load_arm(config).joints)
    if config.domain is not None:
        options["domain"] = config.domain
    return options


PLUGIN = DevicePlugin(
    name="ros2-control",
    summary="robots behind ros2_control: forward controllers, trajectory controller, hardware life cycle",
    config=Ros2ControlConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="ros2-control",
    extra="ros2-control",
    addresses=("controller_manager",),
    check_real=required("controller_manager", "/controller_manager"),
    sim_config=_at_sim,
    sim_options=_sim_options,
    tools=TOOLS,
    typical={
        "joints": [{"name": "joint_1"}],
        "position_controller": "forward_position_controller",
        "velocity_controller": "forward_velocity_controller",
        "effort_controller": "forward_effort_controller",
        "trajectory_controller": "joint_trajectory_controller",
        "allow_untimed": True,
    },
)
