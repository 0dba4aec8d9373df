"""Judges of names, types and quality of service: of the graph alone."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, Final

from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.observed import (
    STATE_SERVICE,
    Endpoint,
    Observation,
)
from crtk_drivers.commands import (
    FRAMES,
    ROS_TYPES,
    SUB_NAMESPACES,
    Command,
    Kind,
    Level,
    Payload,
    Space,
    is_name,
)

_LIKE_CRTK: Final = re.compile(r"(measured\d?|setpoint|goal|servo|interpolate|move)_[jc][a-z]*")
_UNCLEAN: Final = re.compile(r"[ \-.()\[\]]")
_UNKNOWN_HASH: Final = re.compile(r"(RIHS01_0+|INVALID)?", re.IGNORECASE)
_STATE_PAYLOADS: Final = (Payload.OPERATING_STATE, Payload.TEXT)
_SERVICES: Final = {
    "operating_state": STATE_SERVICE,
    "forward_kinematics": ROS_TYPES[Payload.FORWARD_KINEMATICS],
    "inverse_kinematics": ROS_TYPES[Payload.INVERSE_KINEMATICS],
}


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(set(names)))


def known_names(seen: Observation) -> Finding:
    """NAM-1."""
    names = {each.name for each in seen.graph.endpoints}
    alike = {each for each in names if _LIKE_CRTK.fullmatch(each.rpartition("/")[2])}
    unknown = [each for each in alike if not is_name(each.rpartition("/")[2])]
    if unknown:
        return diverges(f"not in CRTK: {_listed(unknown)}")
    if not alike:
        return undetermined("no topic has such a name")
    elsewhere = {e.rpartition("/")[0] for e in alike} - {"", *SUB_NAMESPACES}
    note = f"; sub-namespaces of its own: {_listed(elsewhere)}" if elsewhere else ""
    return conforms(f"{len(alike)} names, all known{note}")


def clean_namespace(seen: Observation) -> Finding:
    """NAM-2."""
    found = _UNCLEAN.findall(seen.graph.namespace)
    return diverges(f"{seen.graph.namespace!r} holds {found}") if found else conforms("clean")


def cartesian_children(seen: Observation) -> Finding:
    """NAM-3."""
    children = [each.name for each in seen.graph.endpoints if each.name.partition("/")[0] in FRAMES]
    joints = [each for each in children if re.search(r"_j[a-z]$", each)]
    if joints:
        return diverges(f"of joints: {_listed(joints)}")
    if not children:
        return not_offered(f"none of {', '.join(FRAMES)}")
    return conforms(f"{len(set(children))} names")


def grippers(seen: Observation) -> Finding:
    """NAM-4."""
    names = {e.name for e in seen.graph.endpoints if e.name.partition("/")[0] in ("jaw", "gripper")}
    if not names:
        return not_offered("no jaw and no gripper")
    return conforms(f"{_listed(names)}")


def _with_type(endpoints: Iterable[tuple[Endpoint, Command]]) -> list[str]:
    return [
        f"{each.name} is {each.ros_type}, not {ROS_TYPES[row.payload]}"
        for each, row in endpoints
        if each.ros_type != ROS_TYPES[row.payload]
    ]


def payload_types(seen: Observation) -> Finding:
    """TYP-1."""
    found = [
        (each, row)
        for each, row in (*seen.graph.published(), *seen.graph.commanded())
        if row.payload not in _STATE_PAYLOADS
    ]
    wrong = _with_type(found)
    if wrong:
        return diverges("; ".join(sorted(set(wrong))))
    return conforms(f"{len(found)} endpoints") if found else not_offered("no such names")


def state_types(seen: Observation) -> Finding:
    """TYP-2."""
    found = [
        (each, row)
        for each, row in (*seen.graph.published(), *seen.graph.commanded())
        if row.payload in _STATE_PAYLOADS
    ]
    if not found:
        return not_offered("neither operating_state nor state_command")
    wrong = _with_type(found)
    if wrong:
        return diverges("; ".join(sorted(set(wrong))))
    hashes = {(e.name, e.type_hash, seen.graph.known_hashes.get(e.ros_type, "")) for e, _ in found}
    other = [
        f"{name}: another definition of the message ({theirs})"
        for name, theirs, ours in hashes
        if theirs != ours and not (_UNKNOWN_HASH.fullmatch(theirs) or _UNKNOWN_HASH.fullmatch(ours))
    ]
    if other:
        return diverges(_listed(other))
    if any(_UNKNOWN_HASH.fullmatch(theirs) for _, theirs, _ in hashes):
        return undetermined("the types are right by name; the middleware tells no hash of them")
    return conforms("types and hashes are those of crtk_msgs")


def service_types(seen: Observation) -> Finding:
    """TYP-3."""
    there = {name: types for name, types in seen.graph.services.items() if name in _SERVICES}
    wrong = [
        f"{name} is {', '.join(types)}, not {_SERVICES[name]}"
        for name, types in there.items()
        if tuple(types) != (_SERVICES[name],)
    ]
    if wrong:
        return diverges("; ".join(wrong))
    return conforms(_listed(there)) if there else not_offered("no service of CRTK")


def _own(seen: Observation) -> dict[str, Command]:
    """Return what is offered outside of sub-namespaces."""
    return {name: row for name, row in seen.graph.offered().items() if "/" not in name}


def states_with_motion(seen: Observation) -> Finding:
    """SET-2."""
    own = _own(seen)
    if not any(row.is_motion for row in own.values()):
        return not_offered("no motion")
    missing = {"operating_state", "state_command"} - set(own)
    return diverges(f"without {_listed(missing)}") if missing else conforms("both are there")


def setpoints_of_commands(seen: Observation) -> Finding:
    """SET-3."""
    own = _own(seen)
    wanted = {
        "setpoint_js" if row.space is Space.JOINT else "setpoint_cp": name
        for name, row in own.items()
        if row.is_motion and row.kind is Kind.POSITION
    }
    if not wanted:
        return not_offered("no position command")
    missing = [
        f"{name} has no {setpoint}" for setpoint, name in wanted.items() if setpoint not in own
    ]
    return diverges(_listed(missing)) if missing else conforms(_listed(wanted))


def goals_of_moves(seen: Observation) -> Finding:
    """SET-4."""
    own = _own(seen)
    movers = [row for row in own.values() if row.level in (Level.INTERPOLATE, Level.MOVE)]
    movers = [row for row in movers if row.kind is not Kind.EFFORT]
    if not movers:
        return not_offered("neither move nor interpolate")
    there = {row.space for row in own.values() if row.level is Level.GOAL}
    missing = [row.name for row in movers if row.space not in there]
    return diverges(f"no goal of {_listed(missing)}") if missing else conforms("each has one")


def reliable_data(seen: Observation) -> Finding:
    """QOS-1."""
    found = list(seen.graph.published())
    lossy = [each.name for each, _ in found if not each.reliable]
    if lossy:
        return diverges(f"best effort, which the official client does not hear: {_listed(lossy)}")
    return conforms(f"{len(found)} publishers") if found else not_offered("nothing is published")


def volatile_commands(seen: Observation) -> Finding:
    """QOS-2."""
    found = list(seen.graph.commanded())
    latched = [each.name for each, _ in found if each.latched]
    if latched:
        return diverges(f"transient local: what was sent long ago is obeyed: {_listed(latched)}")
    return conforms(f"{len(found)} subscriptions") if found else not_offered("it takes no commands")


def latched_state(seen: Observation) -> Finding:
    """QOS-4."""
    found = [
        each
        for each, row in seen.graph.published()
        if row.level is Level.GOAL or row.payload is Payload.OPERATING_STATE
    ]
    if not found:
        return not_offered("neither operating_state nor goals")
    fleeting = [each.name for each in found if not each.latched]
    if fleeting:
        return diverges(f"volatile: who comes later hears nothing of {_listed(fleeting)}")
    return conforms(_listed(each.name for each in found))


def one_publisher(seen: Observation) -> Finding:
    """QOS-7."""
    count = Counter(each.name for each, _ in seen.graph.published())
    many = [f"{name} has {number}" for name, number in count.items() if number > 1]
    if many:
        return diverges(f"publishers: {_listed(many)}")
    return conforms(f"{len(count)} names") if count else not_offered("nothing is published")


def _listed_in(manifest: Mapping[str, Any], key: str) -> list[str]:
    listed = manifest.get(key)
    return [each for each in listed if isinstance(each, str)] if isinstance(listed, list) else []


def manifest_agrees(seen: Observation) -> Finding:
    """MAN-1."""
    told = seen.manifest.get("commands")
    if not isinstance(told, Mapping):
        return not_offered("no manifest")
    offered = set(seen.graph.offered())
    # A part with a state of its own, or one that follows as the manifest says, has a manifest of its own.
    parts = {name.rpartition("/")[0] for name in offered if name.endswith("/operating_state")}
    parts.update(each for each in _listed_in(seen.manifest, "followers") if each)
    offered = {name for name in offered if name.rpartition("/")[0] not in parts}
    claimed = {
        name
        for name, row in told.items()
        if isinstance(row, Mapping) and row.get("direction") in ("published", "commanded")
    }
    faults = [f"{name} is told and not there" for name in sorted(claimed - offered)]
    faults += [f"{name} is there and not told" for name in sorted(offered - claimed)]
    joints = seen.manifest.get("joints")
    measured = seen.trace.joints.get("measured_js", ())
    if isinstance(joints, list) and measured:
        names = tuple(each.get("name") for each in joints if isinstance(each, Mapping))
        if names != measured[-1].name:
            faults.append(f"joints {names} are told, {measured[-1].name} measured")
    return diverges(f"{len(faults)} differences", faults) if faults else conforms("as it says")


GRAPH_JUDGES: Final[Mapping[str, Callable[[Observation], Finding]]] = MappingProxyType(
    {
        "NAM-1": known_names,
        "NAM-2": clean_namespace,
        "NAM-3": cartesian_children,
        "NAM-4": grippers,
        "TYP-1": payload_types,
        "TYP-2": state_types,
        "TYP-3": service_types,
        "SET-2": states_with_motion,
        "SET-3": setpoints_of_commands,
        "SET-4": goals_of_moves,
        "QOS-1": reliable_data,
        "QOS-2": volatile_commands,
        "QOS-4": latched_state,
        "QOS-7": one_publisher,
        "MAN-1": manifest_agrees,
    }
)
