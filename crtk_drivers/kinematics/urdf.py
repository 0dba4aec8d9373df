"""A serial arm from a URDF.

A URDF may come from anywhere: its size is capped, a document type declaration (and with it every
entity, internal or external) is refused, and nothing that it names is opened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.kinematics.chain import LARGEST, Chain, ChainJoint, JointKind, placed, turn
from crtk_drivers.samples import Array

__all__ = [
    "JointRates",
    "ends_of_joints",
    "joint_rates",
    "parse_urdf",
    "urdf_of_joints",
]

MAX_SIZE: Final = 4 * 1024 * 1024
"""Largest URDF that is read, in bytes; the largest humanoids have about a tenth of it."""
MAX_DEPTH: Final = 32
"""Deepest nesting of XML elements; URDF itself needs six."""


class JointRates(NamedTuple):
    """Limits of a joint beside its range, in rad/s (m/s) and N·m (N); 0 where a URDF has none."""

    velocity: float
    effort: float


def joint_rates(
    urdf: bytes | str, joints: Sequence[str], *, where: str = "URDF"
) -> dict[str, JointRates]:
    """Return the limits of velocity and effort of these joints, those that the document has.

    Raises:
        ConfigError: as `parse_urdf`.
    """
    reader = _UrdfReader(_parse_xml(urdf, where), where)
    return reader.rates(joints)


def parse_urdf(
    urdf: bytes | str, *, base: str, tip: str, joints: Sequence[str] = (), where: str = "URDF"
) -> Chain:
    """Return the chain between two links of a URDF (xacro must have been expanded).

    Format: http://wiki.ros.org/urdf/XML/joint. Only the joints on the way from `base` to `tip` matter;
    others (grippers, other arms) are left out.

    Args:
        urdf: the document.
        base: link that carries the chain; need not be the root of the URDF.
        tip: link at the end of the chain.
        joints: the moving joints, in the order of joint vectors; by default that of the chain.
        where: what to call the document in errors.

    Raises:
        ConfigError: too large, not XML, a document type declaration, no such link, no way from base
            to tip, a joint that is no serial arm's (floating, planar, mimic), limits missing or wrong.
    """
    reader = _UrdfReader(_parse_xml(urdf, where), where)
    moving: list[ChainJoint] = []
    placement = np.eye(4)
    for element in reader.path(base, tip):
        placement = placement @ reader.origin(element)
        if element.get("type") != "fixed":
            moving.append(reader.joint(element, placement))
            placement = np.eye(4)
    try:
        return Chain(tuple(moving), placement, tuple(joints))
    except ConfigError as error:
        raise ConfigError(error.message, where=where, remedy=error.remedy) from None


def urdf_of_joints(urdf: bytes | str, joints: Sequence[str], *, where: str = "URDF") -> Chain:
    """Return the chain from the root of a URDF to the last of these joints, and to what is fixed to it.

    For whoever knows joints, but no links. What hangs on the last link by one fixed joint belongs to it, and
    ``tool0`` if there are several.

    Raises:
        ConfigError: as `parse_urdf`, or it has none of these joints.
    """
    base, tip = ends_of_joints(urdf, joints, where=where)
    return parse_urdf(urdf, base=base, tip=tip, where=where)


def ends_of_joints(
    urdf: bytes | str, joints: Sequence[str], *, where: str = "URDF"
) -> tuple[str, str]:
    """Return the links between which `urdf_of_joints` has its chain.

    Raises:
        ConfigError: as `urdf_of_joints`.
    """
    reader = _UrdfReader(_parse_xml(urdf, where), where)
    return reader.ends(joints)


class _UrdfReader:
    """Joints of one parsed URDF."""

    def __init__(self, robot: Element, where: str) -> None:
        self._where = where
        if robot.tag != "robot":
            self._refuse(f"is XML of <{_short(robot.tag)}>", "A URDF begins with <robot>.")
        self._links = [link.get("name", "") for link in robot.iterfind("link")]
        self._above: dict[str, Element] = {}
        for joint in robot.iterfind("joint"):
            child = self._link(joint, "child")
            if child in self._above:
                self._refuse(f"link {_short(child)} is the child of two joints", "Remove one.")
            self._above[child] = joint

    def path(self, base: str, tip: str) -> list[Element]:
        """Return the joints from link `base` to link `tip`."""
        for name in (base, tip):
            if name not in self._links:
                meant = near_names(name, self._links) or self._links[:8]
                self._refuse(
                    f"there is no link {_short(name)}",
                    f"Did you mean {', '.join(map(_short, meant))}?"
                    if meant
                    else "It has no links.",
                )
        joints: list[Element] = []
        link = tip
        while link != base:
            joint = self._above.get(link)
            if joint is None or len(joints) > len(self._above):
                self._refuse(
                    f"link {_short(tip)} does not hang from link {_short(base)}",
                    "The base must lie between the root and the tip.",
                )
            joints.append(joint)
            link = self._link(joint, "parent")
        return joints[::-1]

    def ends(self, joints: Sequence[str]) -> tuple[str, str]:
        """Return the root, and the link behind that of these joints which is farthest from it."""
        ways = [
            self._above_all(link)
            for link, joint in self._above.items()
            if joint.get("name") in joints
        ]
        if not ways:
            self._refuse(
                f"has none of the joints {', '.join(map(_short, joints[:8]))}",
                "Is it the description of another robot?",
            )
        links = max(ways, key=len)
        base, tip = links[-1], links[0]
        for _ in range(MAX_DEPTH):
            fixed = [
                link
                for link, joint in self._above.items()
                if joint.get("type") == "fixed" and self._link(joint, "parent") == tip
            ]
            named = [link for link in fixed if link.rpartition("/")[2] == "tool0"] or fixed
            if len(named) != 1:
                break
            tip = named[0]
        return base, tip

    def _above_all(self, link: str) -> list[str]:
        """Return a link and all that it hangs from."""
        links = [link]
        while links[-1] in self._above and len(links) <= len(self._above):
            links.append(self._link(self._above[links[-1]], "parent"))
        return links

    def rates(self, joints: Sequence[str]) -> dict[str, JointRates]:
        """Return the limits of velocity and effort of joints."""
        found = {}
        for joint in self._above.values():
            name, limit = joint.get("name", ""), joint.find("limit")
            if name in joints and limit is not None:
                (velocity,) = self._numbers(joint, limit, "velocity", 1, "0")
                (effort,) = self._numbers(joint, limit, "effort", 1, "0")
                found[name] = JointRates(velocity, effort)
        return found

    def origin(self, joint: Element) -> Array:
        """Return the placement of a joint in its parent link."""
        element = joint.find("origin")
        if element is None:
            return np.eye(4)
        x, y, z = self._numbers(joint, element, "xyz", 3, "0 0 0")
        roll, pitch, yaw = self._numbers(joint, element, "rpy", 3, "0 0 0")
        return placed(turn(2, yaw) @ turn(1, pitch) @ turn(0, roll), (x, y, z))

    def joint(self, joint: Element, placement: Array) -> ChainJoint:
        """Return a moving joint at `placement` in the frame of the moving joint before it."""
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in ("revolute", "continuous", "prismatic"):
            self._refuse(
                f"joint {_short(name)} is of type {_short(kind)}",
                "Revolute, continuous, prismatic and fixed joints can be part of a serial arm.",
            )
        if joint.find("mimic") is not None:
            self._refuse(
                f"joint {_short(name)} mimics another",
                "Choose a tip above it; no arm has such joints.",
            )
        axis = joint.find("axis")
        direction = (
            [1.0, 0.0, 0.0] if axis is None else self._numbers(joint, axis, "xyz", 3, "1 0 0")
        )
        lower, upper = -math.inf, math.inf
        if kind != "continuous":
            limit = joint.find("limit")
            if limit is None:
                self._refuse(
                    f"joint {_short(name)} has no limit",
                    "Add <limit lower= upper= velocity= effort=/>, or make it continuous.",
                )
            (lower,) = self._numbers(joint, limit, "lower", 1, "0")
            (upper,) = self._numbers(joint, limit, "upper", 1, "0")
        motion = JointKind.PRISMATIC if kind == "prismatic" else JointKind.REVOLUTE
        try:
            return ChainJoint(name, motion, placement, np.array(direction), lower, upper)
        except ConfigError as error:
            self._refuse(error.message, error.remedy)

    def _link(self, joint: Element, end: str) -> str:
        element = joint.find(end)
        name = "" if element is None else element.get("link", "")
        if not name:
            self._refuse(f"joint {_short(joint.get('name', ''))} has no {end} link", "Name it.")
        return name

    def _numbers(
        self, joint: Element, element: Element, key: str, count: int, default: str
    ) -> list[float]:
        text = element.get(key, default)
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(abs(number) <= LARGEST for number in numbers):
            self._refuse(
                f"joint {_short(joint.get('name', ''))}: {element.tag} {key} is {_short(text)}",
                f"It takes {count} finite number{'s' if count > 1 else ''}.",
            )
        return numbers

    def _refuse(self, message: str, remedy: str) -> NoReturn:
        raise ConfigError(message, where=self._where, remedy=remedy)


def _parse_xml(document: bytes | str, where: str) -> Element:
    data = document.encode() if isinstance(document, str) else document
    if len(data) > MAX_SIZE:
        raise ConfigError(
            f"is larger than {MAX_SIZE} bytes", where=where, remedy="Is it the right document?"
        )
    # Text has no encoding left to declare; bytes may declare one.
    parser = expat.ParserCreate("utf-8" if isinstance(document, str) else None)
    builder = TreeBuilder()
    depth = 0

    def refuse_doctype(*_declaration: object) -> None:
        raise ConfigError(
            "has a document type declaration (DOCTYPE)",
            where=where,
            remedy="Remove it: a URDF needs none, and entities are not expanded.",
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ConfigError(
                f"nests elements deeper than {MAX_DEPTH}", where=where, remedy="Is it a URDF?"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
        return builder.close()
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter: unknown encoding
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(
            f"is not well-formed XML: {error}", where=where, remedy="Expand xacro files first."
        ) from None


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
