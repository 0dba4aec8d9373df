"""Runs scenarios from a test or a search: hosts, seeds, and the fewest troubles that a failure needs."""

from __future__ import annotations

import atexit
import inspect
import select
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from crtk_drivers.testing.world.hosts.forking import AGAIN
from crtk_drivers.testing.world.hosts.host_process import PATIENCE, HostProcess, WorldError
from crtk_drivers.testing.world.world_outcome import Outcome


class Host(HostProcess):
    """A process that runs the scenarios of a file, each in a world of its own.

    Args:
        file: that has the scenarios at its top level.
        preload: modules that it imports first.
        fixed: whether addresses are the same in each process; sets of objects are in their order.
    """

    def __init__(self, file: Path, preload: Sequence[str] = (), *, fixed: bool = True) -> None:
        self.file = file
        module = "crtk_drivers.testing.world.hosts.world_host"
        super().__init__(str(file), module, [str(file), *preload, *(() if fixed else (AGAIN,))])

    def ask(
        self,
        scenario: str,
        seed: int,
        *,
        arguments: Sequence[Any] = (),
        before: str = "",
        log: str = "",
        **options: Any,
    ) -> None:
        """Begin to run a seed.

        Args:
            scenario: its function's name.
            seed: of all that happens.
            arguments: of the scenario, after the world.
            before: name of a function that is called first; with ``module:`` before it, of another module.
            log: file for every line of the trace.
            options: of `World`.
        """
        self.send(
            {
                "scenario": scenario,
                "seed": seed,
                "arguments": list(arguments),
                "options": options,
                "before": before,
                "log": log,
            }
        )

    def answer(self, patience: float = PATIENCE) -> Outcome:
        """Return what came of the seed that was asked for.

        Raises:
            WorldError: it cannot be run, or is not done in time.
        """
        return Outcome.of_json(self.receive(patience))

    def run(
        self, scenario: str, seed: int, *, patience: float = PATIENCE, **options: Any
    ) -> Outcome:
        """Run a seed; see `ask` for the options."""
        self.ask(scenario, seed, **options)
        return self.answer(patience)


_hosts: dict[Path, Host] = {}


def _host_of(scenario: Callable[..., object]) -> tuple[Host, str]:
    """Return the host of a scenario's file, started at the first use, and the scenario's name in it."""
    if not inspect.isfunction(scenario) or scenario.__qualname__ != scenario.__name__:
        raise ValueError(f"{scenario!r}: a scenario is a function at the top level of its file")
    if inspect.iscoroutinefunction(scenario) or scenario.__name__ == "<lambda>":
        raise ValueError(f"{scenario!r}: a scenario is a plain function, made by `def`")
    file, name = Path(inspect.getfile(scenario)).resolve(), scenario.__name__
    if file not in _hosts:
        if not _hosts:
            atexit.register(_close_hosts)
        _hosts[file] = Host(file)
    return _hosts[file], name


def _close_hosts() -> None:
    while _hosts:
        _hosts.popitem()[1].close()


def run(scenario: Callable[..., object], seed: int, **options: Any) -> Outcome:
    """Run a scenario with a seed in a world of its own.

    Args:
        scenario: a function at the top level of a file, which is imported anew where the world runs.
        seed: of all that happens.
        options: of `Host.ask`.

    Raises:
        WorldError: it cannot be run.
    """
    host, name = _host_of(scenario)
    try:
        return host.run(name, seed, **options)
    except WorldError:
        _hosts.pop(host.file, host).close()
        raise


def search(
    file: Path,
    scenario: str,
    seeds: Iterable[int],
    *,
    workers: int = 1,
    preload: Sequence[str] = (),
    **options: Any,
) -> Iterator[Outcome]:
    """Run a scenario of a file with many seeds, several at a time; yield the outcomes as they come.

    Args:
        file, scenario: where it is, and what it is called.
        seeds: each in a world of its own.
        workers: how many at a time.
        preload: modules that are imported before the file.
        options: of `Host.ask`.
    """
    waiting = deque(seeds)
    hosts = [Host(file, preload) for _ in range(min(workers, len(waiting)))]
    busy = []
    try:
        for host in hosts:
            host.ask(scenario, waiting.popleft(), **options)
            busy.append(host)
        while busy:
            ready, _, _ = select.select(busy, [], [], PATIENCE)
            for host in ready or busy[:1]:
                outcome = host.answer(PATIENCE if ready else 0.0)
                if waiting:
                    host.ask(scenario, waiting.popleft(), **options)
                else:
                    busy.remove(host)
                yield outcome
    finally:
        for host in hosts:
            host.close()


def shrink(rerun: Callable[[Sequence[int]], Outcome], found: Outcome) -> Outcome:
    """Return a run with the same finding and as few troubles as can be found.

    Args:
        rerun: runs the same seed without some troubles.
        found: a run with a finding.
    """
    best = found
    # What is left out changes what the script does, and then it may meet troubles that it has not met before.
    left_out = set(found.without)
    size = max(1, len(found.kept))
    while kept := best.kept:
        size = min(size, len(kept))
        for start in range(0, len(kept), size):
            more = left_out.union(kept[start : start + size])
            tried = rerun(sorted(more))
            if tried.kinds & found.kinds:
                best, left_out = tried, more
                break
        else:
            if size == 1:
                break
            size //= 2
    return best
