"""What is said of machines of a lab that cannot meet on ROS."""

import re

import pytest

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.reachable import REMEDY, doubts_between

TWO = """
[devices.arm]
plugin = "loopback"
machine = "control"
[devices.camera]
plugin = "loopback"
machine = "tracking"
"""
DOMAIN = "environment = { ROS_DOMAIN_ID = 42 }\n"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
OFF = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
PEERS = {"ROS_STATIC_PEERS": "192.168.1.2"}


@pytest.fixture
def doubts(tmp_path):
    def found(text, variables, machine="control"):
        path = tmp_path / "lab.toml"
        path.write_text(text)
        return list(doubts_between(load_lab(path, machine=machine), variables))

    return found


@pytest.mark.parametrize(
    ("variables", "why"),
    [
        ({}, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, ""),
        (LOCAL, "RANGE is LOCALHOST"),
        (LOCAL | PEERS, ""),
        (OFF | PEERS, "RANGE is OFF"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "subnet"}, "takes for LOCALHOST"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "ROS_LOCALHOST_ONLY is 1"),
        (LOCAL | {"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, ""),
        (LOCAL | {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, ""),
    ],
)
def test_machines_that_cannot_meet_are_told(doubts, variables, why):
    found = doubts(DOMAIN + TWO, variables)
    assert len(found) == bool(why)
    for doubt in found:
        assert "cannot see each other" in doubt
        assert why in doubt


@pytest.mark.parametrize("shell", [LOCAL, OFF | PEERS, {"ROS_LOCALHOST_ONLY": "1"}])
def test_what_the_remedy_writes_helps(doubts, shell):
    (doubt,) = doubts(DOMAIN + TWO, shell)
    name, value = re.search(r"Write (\w+) = (\S+) into `environment`", doubt).groups()
    assert doubts(DOMAIN + TWO, {**shell, name: value.strip('"')}) == []


def test_a_domain_of_the_shell_alone_is_told(doubts):
    (doubt,) = doubts(TWO, {"ROS_DOMAIN_ID": "7"})
    assert "shell of each machine decides its domain (ROS_DOMAIN_ID, here 7)" in doubt


def test_one_machine_meets_itself(doubts):
    assert doubts(TWO, LOCAL, machine="all") == []
    assert doubts(TWO.replace("tracking", "control"), LOCAL) == []


def test_the_remedy_is_one(doubts):
    line = REMEDY.removeprefix("Write ").partition(" above")[0]
    assert doubts(f"{line}\n{TWO}", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}) == []
