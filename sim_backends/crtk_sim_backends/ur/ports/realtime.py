"""The packet of the real-time ports 30003 and 30013.

Source: UR "Client Interface", spreadsheet of the real-time client: one table that grew at its end
with every version, so that an older packet is a shorter one.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.ur.versions import Version

LENGTHS_E: Final = (((5, 0), 1108), ((5, 4), 1116), ((5, 9), 1140), ((5, 10), 1220))
LENGTHS_CB3: Final = (
    ((3, 0), 1044),
    ((3, 2), 1060),
    ((3, 5), 1108),
    ((3, 10), 1116),
    ((3, 14), 1140),
    ((3, 15), 1220),
)
"""Length of the packet, bytes, from that software version on."""

_FULL: Final = struct.Struct(">I152d")
_ZERO3: Final = (0.0,) * 3
_ZERO6: Final = (0.0,) * 6


def packet_length(version: Version) -> int:
    """Length of the packet of a software version, bytes."""
    table = LENGTHS_E if version[0] >= 5 else LENGTHS_CB3
    return max(length for since, length in table if version[:2] >= since)


def packet(outputs: Mapping[str, Any], length: int) -> bytes:
    """Build the packet from the RTDE outputs.

    Args:
        outputs: process image by RTDE variable name.
        length: :func:`packet_length` of the version.
    """
    full = _FULL.pack(
        length,
        outputs["timestamp"],
        *outputs["target_q"],
        *outputs["target_qd"],
        *outputs["target_qdd"],
        *outputs["target_current"],
        *outputs["target_moment"],
        *outputs["actual_q"],
        *outputs["actual_qd"],
        *outputs["actual_current"],
        *outputs["joint_control_output"],
        *outputs["actual_TCP_pose"],
        *outputs["actual_TCP_speed"],
        *outputs["actual_TCP_force"],
        *outputs["target_TCP_pose"],
        *outputs["target_TCP_speed"],
        float(outputs["actual_digital_input_bits"]),
        *outputs["joint_temperatures"],
        outputs["actual_execution_time"],
        0.0,  # test value
        outputs["robot_mode"],
        *outputs["joint_mode"],
        outputs["safety_mode"],
        *_ZERO6,
        *outputs["actual_tool_accelerometer"],
        *_ZERO6,
        outputs["speed_scaling"],
        outputs["actual_momentum"],
        0.0,
        0.0,
        outputs["actual_main_voltage"],
        outputs["actual_robot_voltage"],
        outputs["actual_robot_current"],
        *outputs["actual_joint_voltage"],
        float(outputs["actual_digital_output_bits"]),
        outputs["runtime_state"],
        *outputs["elbow_position"],
        *outputs["elbow_velocity"],
        outputs["safety_status"],
        *_ZERO3,
        outputs["payload"],
        *outputs["payload_cog"],
        *outputs["payload_inertia"],
    )
    return full[:length]
