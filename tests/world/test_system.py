"""The system of a world does what the real one does: small programs see the same in both."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.testing.world import Host, WorldError

FOLDER = Path(__file__).parent
PROGRAMS = FOLDER / "system_programs.py"
NAMES = [
    each.name
    for each in ast.parse(PROGRAMS.read_text()).body
    if isinstance(each, ast.FunctionDef) and not each.name.startswith("_")
]
SEEDS = (3, 6)
"""In the first, threads take turns where they wait only; in the second at every twentieth point."""


class Real:
    """A process that runs programs in the real system."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(FOLDER / "real_system.py"), str(PROGRAMS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, name: str) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(name + "\n")
        self._process.stdin.flush()
        found = json.loads(self._process.stdout.readline())
        assert "error" not in found, found["error"]
        return found["result"]

    def close(self) -> None:
        self._process.communicate()


@pytest.fixture(scope="module")
def real() -> Iterator[Real]:
    found = Real()
    yield found
    found.close()


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host(PROGRAMS) as found:
        yield found


@pytest.mark.sweep(1)  # each program is a promise of its own
@pytest.mark.parametrize("name", NAMES)
def test_world_does_what_linux_does(real: Real, host: Host, name: str) -> None:
    expected = real.run(name)
    for seed in SEEDS:
        outcome = host.run(f"WORLDS.{name}", seed)
        outcome.check()
        assert outcome.result == expected, f"seed {seed}"


def test_seeds_differ_in_preemption(host: Host) -> None:
    calm, lively = (host.run("WORLDS.thread_sums", seed) for seed in SEEDS)
    assert lively.switches > 1.1 * calm.switches


def test_same_seed_gives_the_same_hash(host: Host) -> None:
    for name in ("process_pipes", "thread_pools", "tcp_echo_of_many"):
        one, other = (host.run(f"WORLDS.{name}", 1) for _ in range(2))
        assert one.hash == other.hash


def test_date_is_that_of_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for zone in ("Asia/Tokyo", "America/Lima"):
        monkeypatch.setenv("TZ", zone)
        with Host(FOLDER / "toys.py") as host:
            found.append(host.run("dates", 1, arguments=["somewhere"]).result)
    assert found[0] == found[1]
    assert found[0][0].startswith("2030-03-17T18:")
    assert found[0][1].startswith("2030-03-17 18:")


def test_result_that_is_no_json_is_refused() -> None:
    with Host(FOLDER / "refused_programs.py") as host, pytest.raises(WorldError, match="JSON"):
        host.run("returns_no_json", 1)
