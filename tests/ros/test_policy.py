"""Policies of SROS2: as its schema has them, complete, and allowing nobody more than is meant."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any
from xml.etree import ElementTree

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import main
from crtk_drivers.commands import Direction
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device
from crtk_drivers.device.offered import offered
from crtk_drivers.ros.policy import policy
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice

# The rules of sros2's policy.xsd, version 0.2.0: for each element its attributes, and which children, how
# many of them at least. An attribute with True is required; the rules of a profile have one of two verbs.
SCHEMA: dict[str, tuple[dict[str, bool], dict[str, int]]] = {
    "policy": ({"version": True}, {"enclaves": 1}),
    "enclaves": ({}, {"enclave": 1}),
    "enclave": ({"path": True}, {"profiles": 1}),
    "profiles": ({"type": False}, {"profile": 1, "metadata": 0}),
    "profile": ({"ns": True, "node": True}, {"topics": 0, "services": 0, "actions": 0}),
    "topics": ({"publish": False, "subscribe": False}, {"topic": 1}),
    "services": ({"reply": False, "request": False}, {"service": 1}),
    "actions": ({"call": False, "execute": False}, {"action": 1}),
    "topic": ({}, {}),
    "service": ({}, {}),
    "action": ({}, {}),
}


class WithGripper(LoopbackDevice):
    """An arm with a device behind it."""

    @property
    def children(self) -> Mapping[str, Device]:
        return {"gripper": LoopbackDevice(LoopbackConfig())}


QUALIFIERS = {"ALLOW", "DENY"}
ROLES = ("crtk_driver", "operator", "listener")


def obeys(element: ElementTree.Element) -> None:
    """Hold an element against the schema, and all that is in it."""
    attributes, children = SCHEMA[element.tag]
    assert set(element.attrib) <= set(attributes)
    assert {name for name, needed in attributes.items() if needed} <= set(element.attrib)
    if element.tag in ("topics", "services", "actions"):
        assert element.attrib
        assert set(element.attrib.values()) <= QUALIFIERS
    tags = [child.tag for child in element]
    assert set(tags) <= set(children)
    for tag, least in children.items():
        assert tags.count(tag) >= least, f"{tag} in {element.tag}"
    if children:
        assert not (element.text or "").strip()
    else:
        assert element.text
        assert element.text == element.text.strip()
    for child in element:
        obeys(child)


def device_of(name: str, **values: Any) -> Device:
    plugin = plugins.device(name)
    return plugin.make(load(plugin.config, from_values({**plugin.typical, **values})))


def policy_of(name: str, namespace: str = "/lab/one", **values: Any) -> ElementTree.Element:
    return ElementTree.fromstring(policy(device_of(name, **values), namespace))


def may(
    root: ElementTree.Element, role: str, verb: str, name: str, space: str = "/lab/one"
) -> bool:
    """Judge as DDS does: what is denied is denied, then what is allowed is allowed, then nothing is."""
    kind = "topic" if verb in ("publish", "subscribe") else "service"
    (profile,) = root.findall(f"enclaves/enclave[@path='{space}/{role}']/profiles/profile")
    for qualifier, verdict in (("DENY", False), ("ALLOW", True)):
        for rule in profile.findall(f"{kind}s[@{verb}='{qualifier}']"):
            if any(fnmatchcase(name, each.text or "") for each in rule):
                return verdict
    return False


DEVICES = sorted(name for name, entry in plugins.devices().items() if entry.error is None)


@pytest.mark.parametrize("namespace", ["/", "/ur5", "/lab/left_arm"])
@pytest.mark.parametrize("name", DEVICES)
def test_a_policy_is_what_the_schema_asks_for(name: str, namespace: str) -> None:
    root = policy_of(name, namespace)
    obeys(root)
    assert root.get("version") == "0.2.0"
    space = namespace.rstrip("/")
    paths = [enclave.get("path") for enclave in root.iter("enclave")]
    assert paths == [f"{space}/{role}" for role in ROLES]
    for rule in root.iter():
        if rule.tag in ("topic", "service"):
            assert (rule.text or "").startswith("/")
            assert "//" not in (rule.text or "")


@pytest.mark.parametrize("name", DEVICES)
def test_only_an_operator_commands(name: str) -> None:
    root, device = policy_of(name), device_of(name)
    takes = [
        command for command, row in offered(device).items()
        if row.direction is Direction.COMMANDED
    ]  # fmt: skip
    for command in [*takes, *device.inputs]:
        topic = f"/lab/one/{command}"
        assert may(root, "operator", "publish", topic)
        assert may(root, "crtk_driver", "subscribe", topic)
        assert not may(root, "listener", "publish", topic)
        assert not may(root, "listener", "subscribe", topic)
        assert not may(root, "crtk_driver", "publish", topic)
    for service in [*device.services, "crtk_driver/set_parameters"]:
        full = f"/lab/one/{service}"
        assert may(root, "operator", "request", full)
        assert may(root, "crtk_driver", "reply", full)
        assert not may(root, "listener", "request", full)
        assert not may(root, "operator", "reply", full)


@pytest.mark.parametrize("name", DEVICES)
def test_only_the_driver_tells(name: str) -> None:
    root, device = policy_of(name), device_of(name)
    told = [
        command for command, row in offered(device).items()
        if row.direction is Direction.PUBLISHED
    ]  # fmt: skip
    told += ["refusals", "crtk_driver/crtk_capabilities"]
    told += [each.told_as(reading) for reading, each in device.readings.items()]
    for value in told:
        topic = f"/lab/one/{value}"
        assert may(root, "crtk_driver", "publish", topic)
        for role in ("operator", "listener"):
            assert may(root, role, "subscribe", topic)
            assert not may(root, role, "publish", topic)
    for query in ("operating_state", "crtk_version", "crtk_driver/get_parameters"):
        for role in ("operator", "listener"):
            assert may(root, role, "request", f"/lab/one/{query}")
            assert not may(root, role, "reply", f"/lab/one/{query}")


def test_what_is_behind_a_device_is_there_too() -> None:
    root = ElementTree.fromstring(policy(WithGripper(LoopbackConfig()), "/lab/one"))
    topic = "/lab/one/gripper/state_command"
    assert may(root, "operator", "publish", topic)
    assert may(root, "crtk_driver", "subscribe", topic)
    assert not may(root, "listener", "publish", topic)


def test_another_device_is_another_matter() -> None:
    root = policy_of("virtual")
    for role in ROLES:
        assert not may(root, role, "publish", "/lab/two/servo_jp")
        assert not may(root, role, "subscribe", "/lab/two/measured_js")
        assert not may(root, role, "request", "/lab/two/crtk_driver/set_parameters")


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policy", "ur", "--ns", "/ur5"]) == 0
    root = ElementTree.fromstring(capsys.readouterr().out)
    obeys(root)
    assert may(root, "operator", "publish", "/ur5/servo_jp", "/ur5")
    assert not may(root, "listener", "publish", "/ur5/servo_jp", "/ur5")


def test_without_a_configuration_a_device_without_joints_is_a_typical_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["policy", "dynamixel", "--ns", "/arm"]) == 0
    assert "/arm/servo_jp<" in capsys.readouterr().out


def test_the_configuration_decides_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policy", "ati-netft", "--ns", "/ft", "--arm", "/ur5"]) == 0
    assert "/ft/orientation" not in capsys.readouterr().out
    assert main(["policy", "ati-netft", "--ns", "/ft"]) == 0
    assert "/ft/orientation" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["policy", "ur", "--ns", "ur 5"], "is not a namespace"),
        (["policy", "nothing"], "nothing"),
        (["policy", "ur", "--ros-args"], "starts no node"),
    ],
)
def test_what_makes_no_policy_is_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    found = capsys.readouterr()
    assert message in found.err
    assert not found.out
