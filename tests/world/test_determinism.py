"""One seed gives one run, of each device, whatever process it runs in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from world.plain_worlds import ABSENT, visits

from crtk_drivers import plugins
from crtk_drivers.testing.world import Host

FILE = Path(__file__).with_name("plain_worlds.py")
PROMISES = Path(__file__).with_name("promises.py")
NAMES = sorted(vars(visits))


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host(FILE) as found:
        yield found


@pytest.fixture(scope="module")
def other_host() -> Iterator[Host]:
    """A host with random addresses, in which another world has run."""
    with Host(FILE, fixed=False) as found:
        found.run("visits.inputs", 7)
        yield found


@pytest.mark.parametrize("name", NAMES)
def test_one_seed_gives_one_run(host: Host, other_host: Host, name: str) -> None:
    one = host.run(f"visits.{name}", 1)
    one.check()
    assert one.hash == other_host.run(f"visits.{name}", 1).hash


@pytest.mark.parametrize("name", NAMES)
def test_bad_weather_is_of_the_seed(host: Host, other_host: Host, name: str) -> None:
    one = host.run(f"visits.{name}", 1, wild=True)
    one.check()
    assert one.hash == other_host.run(f"visits.{name}", 1, wild=True).hash


def test_a_node_and_its_clients_are_of_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    hashes = set()
    for fixed, domain in ((True, "7"), (False, "8")):
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        with Host(PROMISES, fixed=fixed) as host:
            one = host.run("far", 1, wild=True, arguments=["robotiq"])
            one.check()
            hashes.add(one.hash)
    assert len(hashes) == 1


@pytest.mark.parametrize("wild", [False, True], ids=["good weather", "bad weather"])
def test_another_seed_gives_another_run(host: Host, wild: bool) -> None:
    hashes = [host.run("visits.robotiq_tcp", seed, wild=wild).hash for seed in (1, 2, 3)]
    assert len(set(hashes)) == len(hashes)


def test_every_simulated_device_is_here() -> None:
    here = {visit.device for visit in vars(visits).values()}
    assert not here & ABSENT.keys()
    assert here | ABSENT.keys() == plugins.devices().keys() & plugins.sims().keys()
