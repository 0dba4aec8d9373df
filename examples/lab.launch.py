"""Start the devices and programs of a lab with `ros2 launch`, instead of `crtk-driver up`.

ros2 launch examples/lab.launch.py lab:=lab.toml sim:=true devices:="arm ft"

Of a lab on several machines it starts the share of this one, by its host name or machine:=control.
Needs a ROS 2 installation with `launch`, sourced, and crtk-drivers in its Python. The processes are those
that `crtk-driver up` starts, with the same settings and `environment`. What launch cannot do: wait until a
device measures (drivers keep trying until they find what they need), stop the hardware in order, or leave
alone a device that is set up wrongly.
"""

import tempfile
from pathlib import Path

from crtk_drivers.labs import device_command, load_lab, settings_text

FIRST_SIGNAL_TIMEOUT = "20"
"""Seconds that a device has to stop its hardware after SIGINT."""


def processes(context):
    """Return the actions that start each device, then each program."""
    from launch.actions import ExecuteProcess, LogInfo
    from launch.substitutions import LaunchConfiguration

    def given(name):
        return LaunchConfiguration(name).perform(context)

    lab = load_lab(
        given("lab"),
        sim=given("sim").lower() == "true",
        only=tuple(given("devices").split()),
        machine=given("machine"),
    )
    folder = Path(tempfile.mkdtemp(prefix=f"{lab.name}-"))
    actions = [LogInfo(msg=f"left out: {lab.left_out}")] if lab.left_out else []
    for name, device in lab.devices.items():
        settings = folder / f"{name}.yaml"
        settings.write_text(settings_text(device), "utf-8")
        actions.append(
            ExecuteProcess(
                name=name,
                cmd=list(device_command(device, settings)),
                cwd=str(lab.path.parent),
                additional_env=dict(lab.environment),
                output="both",
                respawn=True,
                respawn_delay=1.0,
                sigterm_timeout=FIRST_SIGNAL_TIMEOUT,
            )
        )
    actions += [
        ExecuteProcess(
            name=name,
            cmd=list(program.command),
            cwd=str(lab.path.parent),
            additional_env=dict(lab.environment),
            output="both",
        )
        for name, program in lab.programs.items()
    ]
    return actions


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    return LaunchDescription(
        [
            DeclareLaunchArgument("lab", description="The lab file."),
            DeclareLaunchArgument(
                "sim", default_value="false", description="Simulate every device."
            ),
            DeclareLaunchArgument(
                "devices", default_value="", description="Only these, and no programs."
            ),
            DeclareLaunchArgument(
                "machine",
                default_value="",
                description="Which machine of the lab this is; all: the whole lab. By host name if empty.",
            ),
            OpaqueFunction(function=processes),
        ]
    )
