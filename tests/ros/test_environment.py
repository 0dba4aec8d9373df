"""How this process talks to other ROS processes, as environment variables."""

from __future__ import annotations

import os

import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.ros import environment
from crtk_drivers.ros.environment import LOOPBACK, PROFILES, RANGE, TRANSPORTS

SAID = (
    RANGE,
    TRANSPORTS,
    *PROFILES,
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "RMW_IMPLEMENTATION",
)
ON_THE_NETWORK = {TRANSPORTS: "UDPv4"}
ON_THIS_MACHINE = {RANGE: "SYSTEM_DEFAULT", **dict.fromkeys(PROFILES, str(LOOPBACK))}


@pytest.mark.parametrize(
    ("said", "changed"),
    [
        ({}, ON_THE_NETWORK),
        ({RANGE: "SUBNET"}, ON_THE_NETWORK),
        ({RANGE: "LOCALHOST"}, ON_THIS_MACHINE),
        ({RANGE: "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_fastrtps_dynamic_cpp"}, ON_THIS_MACHINE),
        ({RANGE: "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, {}),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"}, {}),
        ({RANGE: "LOCALHOST", PROFILES[0]: "/etc/mine.xml"}, {}),
        ({"ROS_LOCALHOST_ONLY": "1"}, {}),
        ({TRANSPORTS: "DEFAULT"}, {}),
    ],
)
def test_only_what_the_user_left_open_is_decided(
    monkeypatch: pytest.MonkeyPatch, said: dict[str, str], changed: dict[str, str]
) -> None:
    for name in SAID:
        monkeypatch.delenv(name, raising=False)
    for name, value in said.items():
        monkeypatch.setenv(name, value)
    for name in SAID:  # so that what is set below is taken back
        monkeypatch.setenv(name, os.environ.get(name, ""))
    environment.share_no_memory()
    now = {name: os.environ[name] for name in SAID if os.environ[name]}
    assert now == said | changed


def test_the_profile_is_there() -> None:
    assert "127.0.0.1" in LOOPBACK.read_text()


@pytest.fixture
def nothing_said(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SAID:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("nothing_said")
@pytest.mark.parametrize("domain", ["abc", "300", "-1", "1.5", " 7", "²"])
def test_a_domain_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, domain: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(ConfigError, match=r"is not a ROS domain.* 0 to 232"):
        environment.check()


@pytest.mark.usefixtures("nothing_said")
@pytest.mark.parametrize(
    ("said", "reach"),
    [
        ({}, "from anywhere in the local network (ROS_AUTOMATIC_DISCOVERY_RANGE is not set)"),
        (
            {RANGE: "SUBNET"},
            "from anywhere in the local network (ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET)",
        ),
        ({RANGE: "LOCALHOST"}, ""),
        ({RANGE: "OFF"}, ""),
        (
            {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"},
            "from 192.0.2.7 (ROS_STATIC_PEERS)",
        ),
        ({"ROS_LOCALHOST_ONLY": "1"}, ""),
        ({PROFILES[0]: "/etc/mine.xml"}, ""),
        ({"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}, ""),
    ],
)
def test_who_can_reach_a_driver_is_known(
    monkeypatch: pytest.MonkeyPatch, said: dict[str, str], reach: str
) -> None:
    for name, value in said.items():
        monkeypatch.setenv(name, value)
    assert environment.reach() == reach
