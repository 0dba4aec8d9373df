"""The file by which MoveIt knows the actions of a device. No ROS here.

Format: moveit_simple_controller_manager.cpp of moveit2, which reads ``moveit_simple_controller_manager.*``
and asks the action ``<name>/<action_ns>``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import yaml

from crtk_drivers.config import NodeConfig
from crtk_drivers.device import Device
from crtk_drivers.ros.controllers import ACTION_TYPES, GRIP, actions_of
from crtk_drivers.ros.joint_names import JointNames

MANAGER: Final = "moveit_simple_controller_manager"


def controllers_file(device: Device, namespace: str, node: NodeConfig) -> str:
    """Return the file as YAML, with the devices behind this one.

    Args:
        device: not open.
        namespace: of the driver.
        node: what its node serves.
    """
    found = dict(_controllers(device, namespace.strip("/"), node))
    content = {
        "moveit_controller_manager": f"{MANAGER}/MoveItSimpleControllerManager",
        MANAGER: {"controller_names": list(found), **found},
    }
    return yaml.safe_dump(content, sort_keys=False)


def _controllers(
    device: Device, space: str, node: NodeConfig
) -> Iterator[tuple[str, dict[str, Any]]]:
    actions = actions_of(device)
    if actions:
        action = GRIP if GRIP in actions else actions[0]
        name, action_ns = (space, action) if space else (action, "")
        joints = JointNames(node.joint_prefix).outgoing(device.capabilities.joints)
        yield (
            name,
            {
                "type": ACTION_TYPES[action],
                "action_ns": action_ns,
                "default": True,
                "joints": list(joints),
            },
        )
    for child, behind in device.children.items():
        yield from _controllers(behind, f"{space}/{child}".strip("/"), node)
