"""A chain as URDF, for programs that show or plan: joints with their limits, and sticks between them.

Format: http://wiki.ros.org/urdf/XML.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from crtk_drivers.device import JointLimits
from crtk_drivers.kinematics.chain import Chain, ChainJoint, JointKind
from crtk_drivers.samples import Array, Vector

__all__ = ["link_of", "urdf_of"]

_LOCKED: Final = 1e-9
"""Cosine of the pitch under which roll and yaw are about one axis."""
_SHORTEST: Final = 1e-3
"""m that a stick has at least."""
_THICKNESS: Final = 0.02
"""Radius of a stick, as a share of all of them together."""
_ENDLESS: Final = 1e9
"""m that a joint slides which has no limits."""


def link_of(joint: str) -> str:
    """Return the name of the link that a joint moves."""
    return f"{joint}_link"


def urdf_of(
    chain: Chain,
    limits: Sequence[JointLimits],
    *,
    name: str,
    base: str,
    tip: str,
    frame: Callable[[str], str] = str,
    joint: Callable[[str], str] = str,
) -> str:
    """Return a chain as URDF.

    Args:
        chain: from base to tip.
        limits: in the order of `Chain.names`.
        name: of the robot.
        base, tip: names of the first and of the last link.
        frame: names a link as the frame that it is; by default as it is.
        joint: names a joint; by default as it is.
    """
    robot = Element("robot", name=name)
    radius = _THICKNESS * max(chain.links_length, 0.1)
    by_name = dict(zip(chain.names, limits, strict=True))
    parent = frame(base)
    link = _link(robot, parent)
    for each in chain.joints:
        _stick(link, each.placement[:3, 3], radius)
        child = frame(link_of(each.name))
        _joint(robot, each, joint(each.name), by_name[each.name], parent, child)
        parent, link = child, _link(robot, child)
    _stick(link, chain.tip[:3, 3], radius)
    fixed = SubElement(robot, "joint", name=f"{tip}_fixed", type="fixed")
    _connect(fixed, parent, frame(tip), chain.tip)
    _link(robot, frame(tip))
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def _link(robot: Element, name: str) -> Element:
    return SubElement(robot, "link", name=name)


def _joint(
    robot: Element, joint: ChainJoint, name: str, limit: JointLimits, parent: str, child: str
) -> None:
    bounded = math.isfinite(joint.lower) and math.isfinite(joint.upper)
    is_sliding = joint.kind is JointKind.PRISMATIC
    kind = joint.kind.value if bounded or is_sliding else "continuous"
    element = SubElement(robot, "joint", name=name, type=kind)
    _connect(element, parent, child, joint.placement)
    SubElement(element, "axis", xyz=_words(joint.axis))
    given = {"effort": limit.effort, "velocity": limit.velocity}
    if kind != "continuous":
        given |= {"lower": max(joint.lower, -_ENDLESS), "upper": min(joint.upper, _ENDLESS)}
    finite = {key: _number(min(value, _ENDLESS)) for key, value in given.items()}
    SubElement(element, "limit", finite)


def _connect(joint: Element, parent: str, child: str, placement: Array) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _origin(joint, placement[:3, 3], _rpy(placement[:3, :3]))


def _stick(link: Element, end: Vector, radius: float) -> None:
    """Show a link from its origin to a point."""
    x, y, z = end.tolist()
    length = math.hypot(x, y, z)
    if length < _SHORTEST:
        return
    visual = SubElement(link, "visual")
    _origin(visual, end / 2.0, (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)))
    geometry = SubElement(visual, "geometry")
    SubElement(geometry, "cylinder", length=_number(length), radius=_number(radius))


def _origin(element: Element, position: Vector, rpy: Sequence[float]) -> None:
    SubElement(element, "origin", xyz=_words(position), rpy=_words(np.array(rpy)))


def _rpy(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    r = rotation.tolist()
    cosine = math.hypot(r[0][0], r[1][0])
    pitch = math.atan2(-r[2][0], cosine)
    if cosine < _LOCKED:
        return math.atan2(-r[1][2], r[1][1]), pitch, 0.0
    return math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])


def _words(values: Vector) -> str:
    return " ".join(_number(value) for value in values.tolist())


def _number(value: float) -> str:
    return repr(float(value) + 0.0)  # no -0.0
