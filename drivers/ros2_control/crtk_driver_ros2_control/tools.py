"""Commands for people: what a robot has, written as a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from pydantic import Field
from rich.console import Console

from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.written import configuration_of, roles_in, text_of, untimed_in
from crtk_drivers.config import Settings
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import Tool

__all__ = ["TOOLS"]


class DescribeOptions(Settings):
    """Options of ``describe``."""

    folder: str = Field(
        default="",
        description="Write robot.yaml, and robot.urdf if the robot publishes one, into this folder, which is "
        "made if need be.",
    )


def _describe(config: Ros2ControlConfig, options: Any) -> int:
    from crtk_driver_ros2_control.foreign.survey import survey

    console = Console(highlight=False, soft_wrap=True)
    found = survey(config.controller_manager, config.domain, config.open_timeout)
    roles = roles_in(found.controllers, found.orders)
    keys = {name: f"{role}_controller" for role, name in roles.items()}
    for name, one in found.controllers.items():
        console.print(f"{name}: {one.state}, {one.type}", markup=False)
        if name in keys:
            console.print(
                f"    {keys[name]}: {', '.join(found.orders.get(name, ()))}", markup=False
            )
    console.print(f"robot_description: {'there' if found.description else 'none'}")
    if not roles:
        raise ConfigError(
            "no controller here takes positions, velocities, efforts or trajectories",
            where=config.controller_manager,
            remedy="Load and configure one, such as forward_command_controller.",
        )
    joints = next(filter(None, (found.orders.get(name) for name in roles.values())), ())
    if options.folder:
        folder = Path(options.folder).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        urdf = folder / "robot.urdf"
        values = configuration_of(
            config.controller_manager, roles, joints, found.description, str(urdf)
        )
        if found.description:
            urdf.write_text(found.description)
        path = folder / "robot.yaml"
        untimed = untimed_in(roles)
        path.write_text(text_of(values, untimed))
        console.print(f"written: {path}", markup=False)
        for key, name in untimed.items():
            console.print(
                f"left out: {key}, {name}. It has no timeout: the joints go on when this driver dies. "
                "With an emergency stop at hand take away the # before it, and that before allow_untimed.",
                markup=False,
            )
        if len(untimed) == len(roles):
            console.print(
                "There is no other controller for all joints: as it is, this file is refused at start. A "
                "position or trajectory controller, loaded and configured, is what it lacks."
            )
        if "joints" in values:
            console.print("Its limits are to be looked at before anything moves.")
    return 0


TOOLS: Final = (
    Tool(
        "describe",
        "tells which controllers a robot has, and writes a configuration for it",
        _describe,
        DescribeOptions,
    ),
)
