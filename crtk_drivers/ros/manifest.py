"""The capability manifest: what a device can do, told on the wire.

Published once, latched, as JSON in a std_msgs/String on ``~/crtk_capabilities``. Schema
``crtk_capabilities/1``; lengths in m, angles in rad, times in s, rates in Hz; null is "not known":

    schema          "crtk_capabilities/1"
    crtk_version    of the message package
    driver_version  of this package
    device          {name, address, type, model}: type as ``tracker``, model as ``UR5e``; or empty
    commands        {CRTK name: {name on ROS, type, direction, level, units, summary}}
    services        {name: {name on ROS, type, summary}}: what it does beyond CRTK
    inputs          {name: {name on ROS, type, summary}}: what it takes beyond CRTK
    readings        {name: {name on ROS, type, summary}}: what it tells beyond CRTK
    followers       [sub-namespace]: parts whose state is that of this device, each with a manifest of its own
    joints          [{name, unit, lower, upper, velocity, acceleration, jerk, effort}], in the order of all
                    vectors; unit of the position: ``rad``, ``m``, ``Pa``, or empty: not known
    tool            limits of the tool, or null
    frames          {base, tool}: as they appear in messages and on /tf
    rates           {io, publish, tf, heartbeat}
    stop            {stream_timeout, interpolate_timeout, on_stream_timeout, link_timeout, description, time}:
                    what happens when the stream of commands, or this process, stops
    following       {error, arrival, lag}: how closely joints follow positions, or null
    command_limits  {clamp_servo, max_step, max_linear_step, max_command_age, following_error}
    homing          whether `home` is needed before positions count
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from crtk_drivers.commands import ROS_TYPES, units_for
from crtk_drivers.engine import Engine
from crtk_drivers.kinematics.joint_axes import joint_units
from crtk_drivers.ros.names import Frames

MANIFEST = "crtk_capabilities"
"""Its topic, below the name of the node."""
SCHEMA = "crtk_capabilities/1"
CRTK_VERSION = "1.3.0"
"""Of crtk_msgs, whose messages and names this node speaks."""


def driver_version() -> str:
    """Return the version of this package, ``unknown`` when it runs from a source tree."""
    try:
        return version("crtk-drivers")
    except PackageNotFoundError:
        return "unknown"


def headline(content: Mapping[str, Any]) -> str:
    """Return what a device is and where, as a manifest says: ``UR5e, ur 192.168.1.10``; or empty."""
    about = content.get("device") or {}
    model = about.get("model", "")
    where = f"{about.get('name', '')} {about.get('address', '')}".strip()
    return ", ".join(filter(None, (model, where)))


def manifest(
    engine: Engine, frames: Frames, rates: Mapping[str, float], ros_names: Mapping[str, str]
) -> dict[str, Any]:
    """Return the manifest as plain data, ready for JSON.

    Args:
        rates: the node's rate parameters.
        ros_names: the full topic or service of each CRTK name, after remapping.
    """
    capabilities, options = engine.capabilities, engine.options
    tool = capabilities.cartesian_limits
    units = joint_units(engine.device)
    commands = {
        name: {
            "name": ros_names[name],
            "type": ROS_TYPES[command.payload],
            "direction": command.direction.value,
            "level": command.level.value,
            "units": units_for(command, units),
            "summary": command.summary,
        }
        for name, command in engine.commands.items()
    }
    return {
        "schema": SCHEMA,
        "crtk_version": CRTK_VERSION,
        "driver_version": driver_version(),
        "device": {
            "name": engine.name,
            "address": engine.device.address,
            "type": capabilities.type,
            "model": capabilities.model,
        },
        "commands": commands,
        "services": {
            name: {
                "name": ros_names[name],
                "type": "std_srvs/srv/Trigger",
                "summary": service.summary,
            }
            for name, service in engine.services.items()
        },
        "inputs": {
            name: {
                "name": ros_names[name],
                "type": ROS_TYPES[taken.payload],
                "summary": taken.summary,
            }
            for name, taken in engine.inputs.items()
        },
        "readings": {
            name: {
                "name": ros_names[reading.told_as(name)],
                "type": ROS_TYPES[reading.payload],
                "summary": reading.summary,
            }
            for name, reading in engine.readings.items()
        },
        "children": sorted(engine.device.children),
        "followers": sorted(engine.device.followers),
        "estimates": sorted(capabilities.estimates),
        "joints": [
            {"name": name, "unit": unit, **_finite(asdict(limits))}
            for name, unit, limits in zip(
                capabilities.joints, units, capabilities.limits, strict=True
            )
        ],
        "tool": None if tool is None else _finite(asdict(tool)),
        "frames": {
            "base": frames.outgoing(capabilities.base_frame),
            "tool": frames.outgoing(capabilities.tool_frame),
        },
        "rates": {
            "io": capabilities.rate,
            "publish": rates["publish_rate"],
            "tf": rates["tf_rate"],
            "heartbeat": rates["heartbeat_rate"],
        },
        "stop": {
            "stream_timeout": options.stream_timeout,
            "interpolate_timeout": options.interpolate_timeout,
            "on_stream_timeout": options.on_stream_timeout,
            **_finite(asdict(capabilities.stop)),
        },
        "following": None
        if capabilities.following is None
        else _finite(asdict(capabilities.following)),
        "command_limits": _finite(asdict(options.limits)),
        "homing": capabilities.needs_homing,
        "transition_timeout": capabilities.transition_timeout,
    }


def type_name(message_type: type) -> str:
    """Return the ROS name of a message or service class: ``sensor_msgs/msg/JointState``."""
    package, kind, *_ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"


def _finite(values: Mapping[str, Any]) -> dict[str, Any]:
    # JSON has no infinity.
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in values.items()
    }
