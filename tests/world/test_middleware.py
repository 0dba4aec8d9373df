"""ROS 2 in a world: programs that use rclpy find and hear each other as they do over Fast DDS."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.testing.world import Host, Outcome

pytest.importorskip("rclpy")
WORLDS = Path(__file__).parent / "ros_worlds.py"


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host(WORLDS) as made:
        yield made


def ran(host: Host, scenario: str, *arguments: Any, seed: int = 1) -> Outcome:
    """Return what came of a world, in which nothing was found."""
    outcome = host.run(scenario, seed, arguments=arguments)
    outcome.check()
    return outcome


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lost_messages_are_sent_again_in_order(host: Host, seed: int) -> None:
    assert ran(host, "reliable", seed=seed).result == list(range(50))


@pytest.mark.parametrize("seed", [1, 2])
def test_best_effort_loses_and_keeps_the_order(host: Host, seed: int) -> None:
    heard = ran(host, "best_effort", seed=seed).result
    assert 20 < len(heard) < 50
    assert heard == sorted(set(heard))


def test_lost_message_comes_with_a_heartbeat(host: Host) -> None:
    (waited,) = ran(host, "repaired").result
    assert 2.9 < waited < 3.2


@pytest.mark.parametrize("executor", ["EventsExecutor", "SingleThreadedExecutor"])
def test_late_subscriber_hears_what_is_kept(host: Host, executor: str) -> None:
    assert ran(host, "latched", executor).result == [2, 3, 4]


def test_dead_participant_disappears_after_its_lease(host: Host) -> None:
    assert 20.0 < ran(host, "missed", True).result < 23.0


def test_participant_that_leaves_disappears_at_once(host: Host) -> None:
    assert ran(host, "missed", False).result < 2.0


def test_incompatible_qos_is_an_event_and_no_match(host: Host) -> None:
    durability = 1 << 1  # RMW_QOS_POLICY_DURABILITY (rmw/qos_policy_kind.h)
    assert ran(host, "unmatched").result == [durability, 0]


@pytest.mark.parametrize("stands", [False, True])
def test_only_a_running_program_acknowledges(host: Host, stands: bool) -> None:
    assert ran(host, "confirmed", stands).result is not stands


def test_a_service_answers(host: Host) -> None:
    assert ran(host, "asked").result == "here"


def test_one_seed_is_one_run(host: Host) -> None:
    first, again, other = (ran(host, "reliable", seed=seed).hash for seed in (7, 7, 8))
    assert first == again != other


@pytest.mark.parametrize("what", ["KEEP_ALL", "deadline", "use_sim_time", "--params-file"])
def test_what_is_missing_is_refused_by_name(host: Host, what: str) -> None:
    assert what in ran(host, "refused", what).result
