"""The description that a simulated robot publishes: an arm whose axes turn about z, y, y, x, y, x."""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.ros2_control.joints import JointLimits

_AXES: Final = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
_PLACES: Final = ("0 0 0.2", "0 0 0.15", "0.4 0 0", "0.3 0 0.05", "0.1 0 0", "0.08 0 0")


def urdf_of(limits: tuple[JointLimits, ...]) -> str:
    """Return a URDF from ``base_link`` to ``tool0``."""
    parts = ['<robot name="sim_robot"><link name="base_link"/>']
    parent = "base_link"
    for place, limit in enumerate(limits):
        link = "tool0" if place == len(limits) - 1 else f"link_{place + 1}"
        parts.append(
            f'<link name="{link}"/><joint name="{limit.name}" type="revolute">'
            f'<parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{_PLACES[place % 6]}"/><axis xyz="{_AXES[place % 6]}"/>'
            f'<limit lower="{limit.lower}" upper="{limit.upper}" velocity="{limit.velocity}" '
            f'effort="{limit.effort}"/></joint>'
        )
        parent = link
    return "".join([*parts, "</robot>"])
