"""What must be true before rclpy is imported. No rclpy here."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from crtk_drivers.config.variables import (
    CYCLONE,
    DECIDING,
    DOMAIN,
    LAST_DOMAIN,
    LOCALHOST_ONLY,
    LOOPBACK,
    PROFILES,
    RANGE,
    RMW,
    SECURED,
    SERVER,
    STATIC_PEERS,
    TRANSPORTS,
    assignments,
    dropped,
    elevated_by,
    is_domain,
    is_unsaid,
    merged,
)
from crtk_drivers.errors import ConfigError, MissingExtra

__all__ = [
    "DOMAIN",
    "LOOPBACK",
    "PROFILES",
    "RANGE",
    "STATIC_PEERS",
    "TRANSPORTS",
    "adopt",
    "check",
    "not_started",
    "reach",
    "share_no_memory",
    "wheels_installed",
]

LIBRARIES = (
    "rclpy",
    "crtk_msgs",
    "diagnostic_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
)
WHEELS_RMW = "rmw_fastrtps_cpp"
"""The only middleware that the rclpy wheels hold; it is linked in."""


def check() -> None:
    """Make sure that ROS 2 can be used by this process.

    Raises:
        MissingExtra: a library is missing.
        ConfigError: the environment asks for what cannot work.
    """
    _check_domain()
    _check_kept()
    for library in LIBRARIES:
        if find_spec(library) is None:
            raise _missing(library)
    if not wheels_installed():
        return
    outside = _rclpy_outside()
    if outside is not None and outside == _wheels_folder():
        raise ConfigError(
            f"the rclpy wheels are in {outside}, as by `pip install --user`, where they do not find their "
            "libraries",
            remedy="Install into a virtual environment: `python3 -m venv venv`, then `venv/bin/pip install`.",
        )
    if outside is not None:
        raise ConfigError(
            "a sourced ROS 2 and the rclpy wheels are both in this environment, and their "
            "libraries would be mixed at random",
            remedy="Use one of them: `env -u PYTHONPATH -u LD_LIBRARY_PATH -u AMENT_PREFIX_PATH` "
            "before the command, or an environment without the extra 'ros' (uv: --no-group ros).",
        )
    wanted = os.environ.get(RMW) or WHEELS_RMW
    if wanted != WHEELS_RMW:
        raise ConfigError(
            f"RMW_IMPLEMENTATION is {wanted}, and the rclpy wheels hold only {WHEELS_RMW}",
            remedy="Run `unset RMW_IMPLEMENTATION`, or use a sourced ROS 2 installation.",
        )
    if os.environ.get(SECURED) == "true":
        raise ConfigError(
            f"{SECURED} is true, and the rclpy wheels are built without security: this process would "
            "be open to all, or not start",
            remedy=f"Use a sourced ROS 2 installation, or `unset {SECURED}`.",
        )


def _check_domain() -> None:
    text = os.environ.get(DOMAIN, "")
    if not is_domain(text):
        raise ConfigError(
            f"{text!r} is not a ROS domain",
            where=DOMAIN,
            remedy=f"A whole number from 0 to {LAST_DOMAIN}, the same for all that shall meet; or "
            f"`unset {DOMAIN}`, which is 0.",
        )


def _check_kept() -> None:
    """Refuse to go on where `sudo` has dropped what decides whom this process meets."""
    lost = {
        name: value
        for name, value in dropped(os.environ).items()
        if name in DECIDING and not is_unsaid(name, value)
    }
    if lost:
        raise ConfigError(
            f"{elevated_by(os.environ)} has dropped {assignments(lost)}",
            remedy=f"Say it again behind it: `{elevated_by(os.environ)} env {assignments(lost)} ...`; "
            "an empty value stands for none. In a lab file, the table `environment` says it.",
        )


def adopt(variables: Mapping[str, str]) -> None:
    """Let this process, and what it starts, meet those that have these variables; before rclpy is used."""
    found = merged(os.environ, variables)
    for name in PROFILES:
        if name not in found:
            os.environ.pop(name, None)
    os.environ.update(found)


def reach() -> str:
    """Return from where other ROS processes can reach this one, in words.

    Empty if from this machine only, or if a file, a discovery server or a keystore decides that.
    """
    secured = (SECURED, "true"), ("ROS_SECURITY_STRATEGY", "Enforce")
    if all(os.environ.get(name) == value for name, value in secured):
        return ""
    if any(os.environ.get(name) for name in (*PROFILES, CYCLONE, SERVER)):
        return ""
    if os.environ.get(LOCALHOST_ONLY) == "1" or os.environ.get(RANGE) in ("LOCALHOST", "OFF"):
        peers = os.environ.get(STATIC_PEERS, "")
        return f"from {peers} ({STATIC_PEERS})" if peers else ""
    return f"from anywhere in the local network ({RANGE} is {os.environ.get(RANGE) or 'not set'})"


def not_started(error: Exception, ros_args: Sequence[str]) -> ConfigError:
    """Return what to tell a user of an error of `rclpy.init`."""
    if "logging directory" in str(error):
        return ConfigError(
            "ROS finds no folder for its logs: neither ROS_LOG_DIR nor HOME is set",
            remedy="Set one of them: `export ROS_LOG_DIR=/tmp/ros_logs`.",
        )
    if not ros_args:
        return ConfigError(f"ROS 2 does not start: {error}", remedy="Look at its variables: `env`.")
    return ConfigError(
        f"ROS does not accept the arguments {' '.join(ros_args)}: {error}",
        remedy="They are as for any ROS 2 node: --ros-args -r from:=to -p name:=value",
    )


def share_no_memory() -> None:
    """Let this process and its children talk to other ROS processes over UDP, unless told how.

    Fast DDS 2.14 puts messages into shared memory under locks that outlive their owner: a process that is
    killed while it holds one stops or crashes those that it talked to, as docs/ros_interface.md shows. A
    driver must survive the death of its clients. Only rmw_fastrtps is concerned; no other reads what is set.
    """
    said = (TRANSPORTS, *PROFILES, LOCALHOST_ONLY, STATIC_PEERS)
    rmw = os.environ.get(RMW) or WHEELS_RMW
    if any(os.environ.get(name) for name in said) or not rmw.startswith("rmw_fastrtps"):
        return
    if os.environ.get(RANGE) == "LOCALHOST":  # where rmw_fastrtps insists on shared memory
        os.environ.update(dict.fromkeys(PROFILES, str(LOOPBACK)), **{RANGE: "SYSTEM_DEFAULT"})
    else:
        os.environ[TRANSPORTS] = "UDPv4"


def _missing(library: str) -> MissingExtra:
    if library == "rclpy" or wheels_installed():
        return MissingExtra(library, "ros")
    remedy = f"Install it: apt install ros-jazzy-{library.replace('_', '-')}"
    if library == "crtk_msgs":
        remedy = "Build the folder crtk_msgs of this project with colcon, and source the result."
    return MissingExtra(library, "ros", because="this ROS 2 has none", remedy=remedy)


def wheels_installed() -> bool:
    """Whether ROS 2 comes from the wheels of the extra, not from a sourced installation."""
    try:
        distribution("ros-rclpy")
    except PackageNotFoundError:
        return False
    return True


def _rclpy_outside() -> Path | None:
    """Return the folder of the rclpy that would be imported; None if it is in this Python environment."""
    spec = find_spec("rclpy")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).resolve().parent.parent
    return None if folder.is_relative_to(Path(sys.prefix).resolve()) else folder


def _wheels_folder() -> Path:
    """Return the folder that the rclpy wheel was installed into."""
    return Path(str(distribution("ros-rclpy").locate_file(""))).resolve()
