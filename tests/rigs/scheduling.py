"""Which worker runs which test: those that compute do not take the processor from those that keep time.

Tests that talk to simulators wait for seven tenths of their time, and fail where a burst of somebody's
CPU makes a simulator or an I/O thread late. So there are more workers than cores, and a part of them are
`nice`: they run nothing but what only computes, with the time that the others leave.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum, StrEnum
from functools import cache
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from typing_extensions import override
from xdist.scheduler.loadscope import LoadScopeScheduling
from xdist.workermanage import WorkerController

from rigs import warm_start

WAITING_A_CORE = 1.5
"""Workers that wait, for the most part: one takes a third of a core, with its simulators. One more makes what
the others run late, on a machine that does something else."""

COMPUTING_A_CORE = 0.5
"""Workers that compute, with what the others leave."""

NICE = 5
"""Of the workers that compute: a third of what another process gets that wants all it can get."""

PIECE = 15.0
"""Seconds that the tests take, about, that a worker gets at a time: they share the fixtures of a module."""

COMPUTING = {
    "ci": 4.0,
    "cli": 0.3,
    "core": 0.1,
    "docs": 1.5,
    "matlab": 1.5,
    "motion": 0.15,
    "tapes": 0.2,
    "plugins": 0.5,
    "test_conftest.py": 2.0,
    "test_bench_proof.py": 2.0,
    "test_bench_together.py": 0.4,
    "test_new_plugin_types.py": 4.0,
    "test_new_plugins.py": 15.0,
    "test_defects_of_an_arm.py": 0.4,
    "test_plant.py": 0.2,
    "test_trials.py": 2.0,
    "unit": 0.03,
    "urscript": 0.05,
    "world": 2.0,
}
"""Folders and files whose tests need no process to be in time, with about how many seconds one takes."""

WORLDS = {
    "all_devices": 0.15,
    "can_hub": 0.02,
    "engine": 0.02,
    "faults": 0.15,
    "grippers": 0.1,
    "ros/client": 0.05,
    "ros/conformance": 0.05,
    "ros/drivers": 0.5,
    "ros/moveit": 0.05,
    "ros/node": 0.05,
    "ros/teleop": 0.05,
    "virtual": 0.08,
    "wire": 0.1,
}
"""Folders whose tests run on a simulated machine, in virtual time, with the seconds that one computes."""

WAITING = {
    "ati_netft/wire/test_stream.py": 0.1,  # the system stamps what it receives
    "force_dimension/faults": 1.0,  # its library talks to the simulator by itself
    "force_dimension/wire": 1.0,
    "labs": 0.3,
    "front": 0.1,
    "openhaptics/wire": 1.0,  # as that of Force Dimension
    "ros": 0.7,
    "ros/client/test_compat.py": 0.7,  # in worlds some fail now and then: tests/UNSTEADY.md
    "ros/client/test_confirmed.py": 0.7,  # what DDS itself confirms, of frozen processes
    "ros/client/test_lab_watch.py": 0.7,  # a program of its own, and what it prints
    "ros/client/test_view_terminal.py": 0.7,  # likewise
    "ros/node/test_command_line.py": 0.7,  # likewise
    "ros/node/test_flood.py": 0.7,  # what DDS itself does with too much
    "ros/node/test_message_hashes.py": 0.7,  # what DDS itself announces
    "ros/node/test_mismatches.py": 0.7,  # what DDS itself tells of QoS
    "ros/node/test_official_client.py": 0.7,  # the thin suite over DDS itself
    "ros/node/test_page.py": 0.7,  # a program of its own, and what it prints
    "ros/node/test_process.py": 0.7,  # likewise
    "ros/node/test_topics.py": 0.7,  # the thin suite over DDS itself
    "ros/node/test_two_machines.py": 0.7,  # namespaces of Linux
    "ros/node/test_units_run.py": 0.7,  # installed programs
    "ros/node/test_unlocked.py": 0.7,  # a compiled library
    "ros/node/test_up.py": 0.7,  # programs of their own, and what they print
    "ros2_control/faults": 1.0,  # its device is rclpy's
    "ros2_control/wire": 0.5,
    "ur/wire/test_control_process.py": 0.5,  # through the vendor's library
    "sim": 0.1,
    "sims": 0.3,
    "test_bench.py": 1.5,
    "test_bench_all.py": 120.0,
    "test_bench_command.py": 4.0,
    "test_bench_forces.py": 3.5,
    "test_bench_links.py": 3.5,
    "test_bench_parts.py": 3.0,
    "test_contract.py": 0.3,
    "test_contract_loopback.py": 0.2,
    "test_examining.py": 8.0,
    "test_examples.py": 3.0,
    "test_lab_tests.py": 1.5,
    "test_own_drivers.py": 12.0,
}
"""Folders whose tests talk to simulators, or step an arm, in real time, likewise. The contract of all devices
is among them: each driver proves by it that the simulated machine is like a real one."""

LENIENT = frozenset({"client", "node", "teleop", "test_contract_loopback.py", "test_lab_tests.py"})
"""Folders and files of `WAITING` that a worker which computes may run too. Almost all of their devices are
loopbacks, which wait for nobody, and each of their waits has a minute."""

EVERY = 3
"""One in so many cases of such a test is quick, if it does not say itself."""

ALONE = ("ur_rtde", "test_examining")
"""In the names of tests of which one of a sort runs at a time: the vendor library streams 500 times a second
and has no priority over others, so that it is the first to be late; a device of rclpy takes half a core."""

NOT_OF_A_WORLD = ("force-dimension", "openhaptics", "ros2-control", "ur_rtde")
"""In the names of tests whose driver does I/O by a C library: they keep real time, in pieces of their own."""

LONGEST_COMPUTATION = 240.0
"""Seconds that a test may take which computes."""

LONGEST_COLLECTION = 120.0
"""Seconds for which workers wait for the first."""

FORKS = "forks"
"""Where workers find the process that forks programs for all of them."""

AUTOGROUP = Path("/proc/self/autogroup")

SORT, IS_FIRST, TOLD = "crtk_sort", "crtk_first", "crtk_told"
"""Keys of `workerinput`."""


class Sort(StrEnum):
    """What a worker is for, where there are enough of them."""

    COMPUTES = "computes"
    WAITS = "waits"
    ANY = "runs all"


_folders: list[TemporaryDirectory[str]] = []
"""What the workers of this process tell it, and each other, if it has any."""


def workers(cores: int) -> int:
    """Return how many workers run all tests."""
    return int((WAITING_A_CORE + COMPUTING_A_CORE) * cores)


def sort_of(number: int, workers: int) -> Sort:
    """Return what worker `number` (from 0) of so many is for."""
    if workers <= 3:
        return Sort.ANY
    share = COMPUTING_A_CORE / (WAITING_A_CORE + COMPUTING_A_CORE)
    return Sort.COMPUTES if number < round(share * workers) else Sort.WAITS


def take_share(given: dict[str, Any]) -> None:
    """Let this worker compete with others as its tests need it.

    It gets a session of its own: Linux may give all processes of one the share of one (sched_autogroup).
    """
    os.setsid()
    Path(given[TOLD], f"{os.getpid()}.session").touch()
    warm_start.server().join(Path(given[TOLD], FORKS))
    if given[SORT] == Sort.COMPUTES:
        os.nice(NICE)
        with suppress(OSError):
            AUTOGROUP.write_text(str(NICE))


def keep_share() -> None:
    """Let this process, which has a session of its own, compete no more than whoever has started it."""
    with suppress(OSError):
        AUTOGROUP.write_text(str(os.getpriority(os.PRIO_PROCESS, 0)))


def interrupt() -> None:
    """Interrupt all workers with a session of their own, which do not hear of Ctrl-C."""
    for folder in _folders:
        for file in Path(folder.name).glob("*.session"):
            with suppress(ProcessLookupError):
                os.kill(int(file.stem), signal.SIGINT)


def invite(node: WorkerController) -> None:
    """Tell a worker, before it is started, what it is."""
    workers = len(node.config.getvalue("tx"))
    number = int(node.gateway.id.removeprefix("gw"))
    if not _folders:
        _folders.append(TemporaryDirectory(prefix="crtk-tests-"))
        node.config.add_cleanup(_folders[0].cleanup)
        if sort_of(0, workers) is not Sort.ANY:
            server = warm_start.server()
            server.begin_for_all(Path(_folders[0].name, FORKS))
            node.config.add_cleanup(server.close)
    node.workerinput[SORT] = sort_of(number, workers).value
    node.workerinput[IS_FIRST] = number == 0
    node.workerinput[TOLD] = _folders[0].name


@contextmanager
def turn(given: dict[str, Any]) -> Iterator[None]:
    """Within it the first worker collects before the others, which then read what it has compiled."""
    collected = Path(given[TOLD], "collected")
    if given[IS_FIRST]:
        try:
            yield
        finally:
            collected.touch()
        return
    deadline = time.monotonic() + LONGEST_COLLECTION
    while not collected.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    yield


class Scheduling(LoadScopeScheduling):
    """Gives out pieces of files, those that take long first, each to a worker that may run it."""

    _pieces: dict[str, str]
    _numbers: dict[str, int]

    @override
    def schedule(self) -> None:
        if self.collection is None:
            self.config.option.loadscopereorder = False
            collected = next(iter(self.registered_collections.values()))
            self._numbers = {name: number for number, name in enumerate(collected)}
            self._pieces = dict(pieces(collected))
        super().schedule()

    @override
    def _split_scope(self, nodeid: str) -> str:
        return self._pieces[nodeid]

    @override
    def _assign_work_unit(self, node: WorkerController) -> None:
        piece = self._next_of(node)
        if piece is None:
            node.shutdown()
            return
        tests = self.workqueue.pop(piece)
        self.assigned_work.setdefault(node, {})[piece] = tests
        node.send_runtest_some([self._numbers[name] for name, done in tests.items() if not done])

    @override
    def remove_node(self, node: WorkerController) -> str | None:
        """Return the test during which a worker ended. It is done with: it would end the next one too."""
        left = self.assigned_work.pop(node)
        unfinished = (test for tests in left.values() for test, done in tests.items() if not done)
        crashed = next(unfinished, None)
        if crashed is None:
            return None
        left[self._pieces[crashed]][crashed] = True
        self.workqueue.update(
            (piece, tests) for piece, tests in left.items() if not all(tests.values())
        )
        for other in self.nodes:
            self._reschedule(other)
        return crashed

    @override
    def _reschedule(self, node: WorkerController) -> None:
        if self._pending_of(self.assigned_work[node]) <= 2:
            super()._reschedule(node)

    def _next_of(self, node: WorkerController) -> str | None:
        """Return the longest of what this worker may run.

        What runs alone comes first, then what waits, then the rest. What a worker that computes may run too
        is left to it for as long as the others have something else that waits.
        """
        computing = node.workerinput.get(SORT) == Sort.COMPUTES
        taken = {sort for other in self.nodes if other is not node for sort in self._alone(other)}

        def may_run(piece: str) -> bool:
            if computing and not (computes(piece) or is_lenient(piece)):
                return False
            return alone(piece) not in taken

        def preferred(piece: str) -> tuple[bool, bool, bool, float]:
            duration = seconds(piece) * len(self.workqueue[piece])
            others_may = is_lenient(piece) and not computing
            return alone(piece) is not None, not computes(piece), not others_may, duration

        return max(filter(may_run, self.workqueue), key=preferred, default=None)

    def _alone(self, node: WorkerController) -> set[str]:
        """Return the sorts of which this worker has something to run, and nobody else may."""
        left = (
            piece for piece, tests in self.assigned_work[node].items() if not all(tests.values())
        )
        return {sort for piece in left if (sort := alone(piece))}


def pieces(collected: list[str]) -> Iterator[tuple[str, str]]:
    """Give each test the name of its piece: its file, a number, and whether it is alone."""
    dealt: Counter[str] = Counter()
    for test in collected:
        file = _file(test)
        apart = alone(test) or next((each for each in NOT_OF_A_WORLD if each in test), None)
        sort = f"{file}::{apart}" if apart else file
        yield test, f"{sort}::{dealt[sort] // max(1, round(PIECE / seconds(file)))}"
        dealt[sort] += 1


def _file(name: str) -> str:
    return name.partition("::")[0]


class Kind(Enum):
    """What the processor of a test's worker is needed for."""

    COMPUTES = "computes"
    WAITS = "waits for what runs in real time"
    WORLD = "computes a simulated machine"


LONG = {Kind.COMPUTES: math.inf, Kind.WAITS: 0.3, Kind.WORLD: 0.1}
"""Seconds from which on a test of this kind is quick in some of its cases only."""

_TABLES = {Kind.COMPUTES: COMPUTING, Kind.WAITS: WAITING, Kind.WORLD: WORLDS}


def _found(name: str) -> tuple[Kind, float]:
    return _told_of(_file(name))


@cache
def _told_of(file: str) -> tuple[Kind, float]:
    """Return what a file's tests do and how long one takes, as a table has it for the nearest folder."""
    parts = PurePosixPath(file).parts
    for number in range(len(parts) - 1, -1, -1):
        begins = range(max(0, number - 2), number + 1)
        for name in ("/".join(parts[begin : number + 1]) for begin in begins):
            for kind, table in _TABLES.items():
                if name in table:
                    return kind, table[name]
    return Kind.WAITS, 0.3


def is_of_a_world(name: str) -> bool:
    """Whether a test runs on a simulated machine."""
    return _found(name)[0] is Kind.WORLD and not any(each in name for each in NOT_OF_A_WORLD)


def computes(name: str) -> bool:
    """Whether a test, a file or a piece of it is a matter of computing only."""
    return _found(name)[0] is Kind.COMPUTES or is_of_a_world(name)


def is_lenient(name: str) -> bool:
    """Whether a test waits for nothing that must be in time."""
    return not LENIENT.isdisjoint(PurePosixPath(_file(name)).parts)


def takes_long(name: str) -> bool:
    """Whether a test is one of those that are quick in some of their cases only."""
    kind, seconds = _found(name)
    return seconds >= LONG[kind]


@cache
def alone(name: str) -> str | None:
    """Return the sort of which only one test may run at a time, None if others may run beside it."""
    return next((sort for sort in ALONE if sort in name and not computes(name)), None)


def seconds(name: str) -> float:
    """Return about how long one of its tests takes."""
    return _found(name)[1]
