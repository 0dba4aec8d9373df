"""Commands that the network loses and DDS repeats seconds later, when somebody has stopped the device."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.testing.world import Host

pytest.importorskip("rclpy")
WORLDS = Path(__file__).parent / "late_worlds.py"


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host(WORLDS) as made:
        yield made


def ran(host: Host, scenario: str, *arguments: Any, seed: int = 1) -> Any:
    """Return what came of a world, in which nothing was found."""
    outcome = host.run(scenario, seed, arguments=arguments)
    outcome.check()
    return outcome.result


@pytest.mark.parametrize("stop", ["hold", "disable", ""])
@pytest.mark.parametrize(("what", "name"), [("velocity", "servo_jv"), ("increment", "servo_jr")])
def test_late_setpoint_moves_nothing(host: Host, what: str, name: str, stop: str) -> None:
    found = ran(host, "lost", what, True, stop)
    assert not found["moved"]
    assert found["refused"] == {f"{name}: too_old": 1}


@pytest.mark.parametrize("stop", ["hold", "pause", "disable"])
def test_late_move_after_a_stop_moves_nothing(host: Host, stop: str) -> None:
    found = ran(host, "lost", "move", True, stop)
    assert not found["moved"]
    assert sum(found["refused"].values()) == 1


def test_late_first_command_after_a_stop_moves_nothing(host: Host) -> None:
    found = ran(host, "lost", "move", False, "hold")
    assert not found["moved"]
    assert found["refused"] == {"move_jp: too_old": 1}


@pytest.mark.parametrize("knows", [True, False])
def test_late_move_is_carried_out_without_a_stop(host: Host, knows: bool) -> None:
    assert ran(host, "lost", "move", knows, "") == {
        "moved": True,
        "state": "ENABLED",
        "refused": {},
    }


@pytest.mark.parametrize(
    ("what", "stop", "state"), [("enable", "disable", "DISABLED"), ("resume", "pause", "PAUSED")]
)
def test_late_enable_after_a_stop_enables_nothing(
    host: Host, what: str, stop: str, state: str
) -> None:
    found = ran(host, "lost", what, True, stop)
    assert found["state"] == state
    assert found["refused"] == {"state_command: too_old": 1}


@pytest.mark.parametrize("idles", [True, False])
@pytest.mark.parametrize("seconds", [-3600.0, -2.0, -0.3, 0.3, 2.0, 3600.0])
def test_a_clock_that_is_set_refuses_no_stream(host: Host, seconds: float, idles: bool) -> None:
    assert ran(host, "clock_set", seconds, idles)["refused"] == {}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_follows_its_own_stop_is_carried_out(host: Host, seed: int) -> None:
    refused = ran(host, "own_order", seed=seed)["refused"]
    # One whose stop comes between two lines of its own carrying out may be refused all the same.
    assert set(refused) <= {"move_jp: too_old"}
    assert sum(refused.values()) <= 1, "of 60"


def test_client_is_not_told_of_what_its_own_stop_overtook(host: Host) -> None:
    found = ran(host, "client_stops")
    assert found["refused"]["servo_jv: too_old"] > 1
    assert not found["told"]
