"""What a controller tells about itself: software version, control box, tool flange.

Source: Universal Robots' RTDE_Python_Client_Library (`rtde_decode.py`) and
Universal_Robots_Client_Library (`read_properties.h`, `datatypes.h`, `hardware_info_message.h` and
their tests), both of 2026. The control box is CB5, subtype 2, and the flange revision 4, as in these
tests; flange 1 is here that of every arm.
"""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.ur.versions import Since, Version

CONTROL_BOX: Final = 5  # CB5; 7 would be CB7
TOOL_FLANGE: Final = 1
_CONTROL_BOX_SUBTYPE: Final = 2
_TOOL_FLANGE_REVISION: Final = 4


HARDWARE_INFO: Final = Since(None, (5, 26), (10, 14))
PROPERTIES: Final = Since(None, (5, 26, 3), (10, 15))
"""First software that tells primary clients of the hardware, and RTDE clients its properties; those
that the library's examples name."""


def sends_hardware_info(version: Version) -> bool:
    """Whether primary clients are told control box and tool flange."""
    return HARDWARE_INFO.reached_by(version)


def properties(version: Version) -> dict[str, tuple[str, int]]:
    """Properties that RTDE clients may read, by name: RTDE type and value.

    Empty for software that does not have them.
    """
    if not PROPERTIES.reached_by(version):
        return {}
    major, minor, bugfix, _ = version
    return {
        "v1.software.version": ("UINT64", major << 48 | minor << 32 | bugfix << 16),
        "v1.control_box.type": ("UINT32", CONTROL_BOX << 24 | _CONTROL_BOX_SUBTYPE << 16),
        "v1.robot_arm.tool_flange.type": (
            "UINT32",
            TOOL_FLANGE << 24 | _TOOL_FLANGE_REVISION << 16,
        ),
    }
