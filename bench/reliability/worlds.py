"""A seed, in a simulated world, of a device and a scenario: run, reduced to what it needs, told.

Devices are those of `tests/world/subjects.py` and `instruments.py`, scenarios those of `promises.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from crtk_drivers.testing.world import Host, Outcome, WorldError, shrink
from crtk_drivers.testing.world.hosts.runner import PATIENCE
from crtk_drivers.testing.world.world_outcome import ranges

TESTS: Final = Path(__file__).parents[2] / "tests"
FILE: Final = TESTS / "world" / "promises.py"
HORIZON: Final = 90.0
"""s of virtual time within which every scenario is done."""

if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

from world.promises import SCENARIOS  # noqa: E402 - it is in the folder of the tests

DEVICES: Final = tuple(dict.fromkeys(name for some in SCENARIOS.values() for name in some))
__all__ = ["DEVICES", "FILE", "HORIZON", "SCENARIOS", "Case", "Runner", "shrunk", "story"]


@dataclass(frozen=True)
class Case:
    """One world.

    Attributes:
        device: name in the table of subjects.
        scenario: name of a function that takes a world and the device.
        seed: of all that happens.
        wild: whether there are bad weather and faults.
        bug: name of a mistake that is planted first, a function in `tests/world/planted.py`, or as
            ``planted_sensors:name`` of another file there.
    """

    device: str
    scenario: str
    seed: int
    wild: bool = True
    bug: str = ""

    def __str__(self) -> str:
        return f"{self.device} {self.scenario} {self.seed}{'' if self.wild else ' fair'}"

    def command(self, without: Sequence[int] = ()) -> str:
        """Return the command that runs it again and prints its story."""
        words = ["python -m bench.world --replay", self.device, self.scenario, str(self.seed)]
        words += [] if self.wild else ["--fair"]
        words += ["--bug", self.bug] if self.bug else []
        words += ["--without", ranges(without)] if without else []
        return " ".join(words)


class Runner:
    """Runs cases in a process, and in another one after one that hung or died.

    Args:
        patience: s of real time within which a world must be done.
        file: that has the scenarios.
    """

    def __init__(self, patience: float = PATIENCE, file: Path = FILE) -> None:
        self._patience = patience
        self._file = file
        self._host: Host | None = None

    def run(self, case: Case, without: Sequence[int] = (), log: str = "") -> Outcome:
        """Run a case.

        Args:
            case: it.
            without: numbers of troubles that are left out.
            log: file for its trace.

        Raises:
            WorldError: it cannot be run. The next one can.
        """
        if self._host is None:
            self._host = Host(self._file)
        try:
            return self._host.run(
                case.scenario,
                case.seed,
                patience=self._patience,
                arguments=[case.device],
                before=case.bug if not case.bug or ":" in case.bug else f"planted:{case.bug}",
                log=log,
                wild=case.wild,
                horizon=HORIZON,
                without=list(without),
            )
        except WorldError:
            self.close()
            raise

    def kill(self) -> None:
        """End its process, from any thread."""
        if host := self._host:
            host.kill()

    def close(self) -> None:
        """End its process; safe to repeat."""
        host, self._host = self._host, None
        if host is not None:
            host.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def shrunk(runner: Runner, case: Case, found: Outcome) -> Outcome:
    """Return a run of a case with the same finding, and as few troubles as can be found."""
    return shrink(lambda without: runner.run(case, without), found)


def story(case: Case, outcome: Outcome, last: int = 60) -> str:
    """Return what happened in a case, and how to see it again, for people."""
    return f"{case}\n{outcome.told(last)}\nSee all of it: {case.command(outcome.without)}"
