"""Who may do what with a device: an access control policy of SROS2, from what the device offers. No ROS here.

Three enclaves under the device's namespace: ``crtk_driver`` is the driver's process; ``operator`` may command
it, set its parameters, and ask for all that it does; ``listener`` may hear everything, and ask what changes
nothing. What is not allowed is denied: no listener can command, and nobody but the driver can say what the
device measures. Names are those without remapping.

The format is that of the schema of sros2, version 0.2.0 (sros2/policy/schemas/policy.xsd, and the design
article "ROS 2 Access Control Policies").
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final
from xml.etree import ElementTree

from crtk_drivers.commands import Direction
from crtk_drivers.config import NodeConfig
from crtk_drivers.device import Device
from crtk_drivers.device.offered import offered, without_state
from crtk_drivers.ros.controllers import SERVICES as ACTION_SERVICES
from crtk_drivers.ros.controllers import TOPICS, actions_of, inputs_of, part
from crtk_drivers.ros.manifest import MANIFEST
from crtk_drivers.ros.names import (
    ACTIONS_NODE_NAME,
    AMONG_DRIVERS,
    DESCRIPTION,
    JOINT_STATES,
    NODE_NAME,
    SERVICES_NODE_NAME,
    STOPS_NODE_NAME,
)
from crtk_drivers.session.recordings import SERVICES

_NODE: Final = NodeConfig()

VERSION: Final = "0.2.0"

DRIVER: Final = "crtk_driver"
OPERATOR: Final = "operator"
LISTENER: Final = "listener"

_LOOKING: Final = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
)
_SETTING: Final = ("set_parameters", "set_parameters_atomically")
_EVERY_NODE: Final = ("/parameter_events", "/rosout")
"""Topics that every node of rclpy publishes."""
_TOLD_BY_ALL: Final = ("/diagnostics", "/tf", *_EVERY_NODE)
"""Topics that the driver shares with others."""


@dataclass(frozen=True, slots=True)
class Interface:
    """What the nodes of one device have on ROS, by full names.

    Attributes:
        publishes: topics that are the device's own.
        shares: topics that it publishes beside others.
        among: topics on which drivers tell each other that they are there.
        takes: topics by which it is commanded.
        answers: services that change nothing.
        serves: services that do something.
        nodes: full names.
    """

    publishes: tuple[str, ...]
    shares: tuple[str, ...]
    among: tuple[str, ...]
    takes: tuple[str, ...]
    answers: tuple[str, ...]
    serves: tuple[str, ...]
    nodes: tuple[str, ...]


def interface(
    device: Device,
    namespace: str,
    own: Collection[str] = (),
    *,
    has_state: bool = True,
    node: NodeConfig = _NODE,
) -> Interface:
    """Return what a device has on ROS in a namespace, without the devices behind it.

    `own` are services that the driver has beside the device's.
    """
    tells_joints = (node.joint_states or node.moveit) and "measured_js" in offered(device)
    actions = actions_of(device) if node.moveit else ()
    space = namespace.rstrip("/")
    commands = offered(device) if has_state else without_state(offered(device))
    by_direction = {
        direction: [name for name, row in commands.items() if row.direction is direction]
        for direction in Direction
    }
    services = tuple(dict.fromkeys((*own, *device.services)))
    stops = {name for name, service in device.services.items() if service.stops}
    nodes = [
        NODE_NAME,
        *([SERVICES_NODE_NAME] if set(services) - stops else []),
        *([STOPS_NODE_NAME] if stops else []),
        *([ACTIONS_NODE_NAME] if actions else []),
    ]

    def full(*names: str) -> tuple[str, ...]:
        return tuple(sorted(f"{space}/{name}" for name in names))

    def of_nodes(names: tuple[str, ...]) -> list[str]:
        return [f"{node}/{name}" for node in nodes for name in names]

    return Interface(
        publishes=full(
            *by_direction[Direction.PUBLISHED],
            *(reading.told_as(name) for name, reading in device.readings.items()),
            "refusals",
            *([DESCRIPTION] if device.kinematics is not None else []),
            *([JOINT_STATES] if tells_joints else []),
            *(part(action, topic) for action in actions for topic in TOPICS),
            f"{NODE_NAME}/{MANIFEST}",
        ),
        shares=tuple(
            topic for topic in _TOLD_BY_ALL if topic != "/tf" or "measured_cp" in commands
        ),
        among=full(AMONG_DRIVERS),
        takes=full(
            *by_direction[Direction.COMMANDED],
            *device.inputs,
            *(inputs_of(device) if node.moveit else ()),
        ),
        answers=full(
            *by_direction[Direction.SERVICE],
            *(["operating_state"] if has_state else []),
            "crtk_version",
            *of_nodes(_LOOKING),
        ),
        serves=full(
            *services,
            *(part(action, service) for action in actions for service in ACTION_SERVICES),
            *of_nodes(_SETTING),
        ),
        nodes=full(*nodes),
    )


def interfaces(device: Device, namespace: str, node: NodeConfig = _NODE) -> Iterator[Interface]:
    """Yield what a device and those behind it have on ROS."""
    yield interface(device, namespace, SERVICES, node=node)
    for name, behind in device.children.items():
        has_state = name not in device.followers
        space = f"{namespace.rstrip('/')}/{name}"
        yield interface(behind, space, has_state=has_state, node=node)


def policy(device: Device, namespace: str, node: NodeConfig = _NODE) -> str:
    """Return the policy of a device as XML.

    Args:
        device: not open.
        namespace: of the driver, checked by `crtk_drivers.ros.names.checked_namespace`.
        node: what its node serves.
    """
    there = tuple(interfaces(device, namespace, node))
    root = ElementTree.Element("policy", version=VERSION)
    enclaves = ElementTree.SubElement(root, "enclaves")
    space = namespace.rstrip("/")
    for name, rules in (
        (DRIVER, _of_driver(there)),
        (OPERATOR, _of_operator(there)),
        (LISTENER, _of_listener(there)),
    ):
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"{space}/{name}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(profiles, "profile", ns=namespace, node=name)
        for rule in rules:
            rule.add_to(profile)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


@dataclass(frozen=True, slots=True)
class _Rule:
    """One row of a profile: what may be done, or may not, with which topics or services."""

    verb: str
    names: tuple[str, ...]
    qualifier: str = "ALLOW"

    def add_to(self, profile: ElementTree.Element) -> None:
        if not self.names:
            return
        kind = _KINDS[self.verb]
        row = ElementTree.SubElement(profile, f"{kind}s", {self.verb: self.qualifier})
        for name in dict.fromkeys(self.names):
            ElementTree.SubElement(row, kind).text = name


_KINDS: Final[Mapping[str, str]] = MappingProxyType(
    {"publish": "topic", "subscribe": "topic", "request": "service", "reply": "service"}
)


def _all(there: tuple[Interface, ...], *fields: str) -> tuple[str, ...]:
    return tuple(name for each in there for field in fields for name in getattr(each, field))


def _of_driver(there: tuple[Interface, ...]) -> list[_Rule]:
    return [
        _Rule("publish", _all(there, "publishes", "shares", "among")),
        _Rule("subscribe", (*_all(there, "takes", "among"), "/parameter_events", "/clock")),
        _Rule("reply", _all(there, "answers", "serves")),
    ]


def _of_operator(there: tuple[Interface, ...]) -> list[_Rule]:
    return [
        *_of_client(there),
        _Rule("publish", _all(there, "takes")),
        _Rule("request", _all(there, "answers", "serves")),
    ]


def _of_listener(there: tuple[Interface, ...]) -> list[_Rule]:
    return [*_of_client(there), _Rule("request", _all(there, "answers"))]


def _of_client(there: tuple[Interface, ...]) -> list[_Rule]:
    """Return what every client needs: to hear the device, and what any node of its own has."""
    own = tuple(f"/*/{name}" for name in (*_LOOKING, *_SETTING))
    return [
        _Rule("reply", tuple(f"{node}/*" for node in _all(there, "nodes")), "DENY"),
        _Rule("publish", _EVERY_NODE),
        _Rule("subscribe", (*_all(there, "publishes", "shares"), "/clock")),
        _Rule("reply", own),
    ]
