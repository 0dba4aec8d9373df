"""A world with programs in it: what a scenario is given."""

from __future__ import annotations

import logging
import random
import threading
import traceback
from collections.abc import Callable, Collection
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.testing.world.machine import kernel as kernels
from crtk_drivers.testing.world.machine.endpoints import Endpoint
from crtk_drivers.testing.world.machine.endpoints import begin as begin_network
from crtk_drivers.testing.world.machine.kernel import DONE, Kernel, Process
from crtk_drivers.testing.world.machine.network import Network
from crtk_drivers.testing.world.machine.processes import be_main_thread, run_main
from crtk_drivers.testing.world.troubles import Troubles, Weather
from crtk_drivers.testing.world.world_outcome import Finding, Line, Outcome

Scenario = Callable[["World"], object]
"""What happens in a world: it runs in the main thread of the first process."""

_PREEMPT: Final = (0.0, 0.005, 0.05)
_LONGEST_LINE: Final = 400


class World:
    """One run.

    Args:
        seed: of all that happens.
        wild: whether there is bad weather, and the processes' threads are held up.
        horizon: s after which it is a finding that the scenario has not ended.
        without: numbers of troubles to leave out.

    Attributes:
        random: for what a scenario chooses.
        troubles: what goes wrong.
    """

    def __init__(
        self, seed: int, *, wild: bool = False, horizon: float = 60.0, without: Collection[int] = ()
    ) -> None:
        self.kernel = Kernel(seed, horizon=horizon)
        self.random = self.kernel.stream("script")
        self.wild = wild
        weather = Weather(self.kernel, self.kernel.stream("weather"))
        self.network = Network[Endpoint](weather)
        self._story: list[Line] = []
        self._without = tuple(without)
        self.troubles = Troubles(self.kernel, self.network, weather, self._tell_trouble, without)
        self.kernel.preempt_share = self.kernel.stream("preemption").choice(_PREEMPT)
        if wild:
            self.troubles.draw_weather()

    # What a scenario uses

    def say(self, text: str) -> None:
        """Add a line to the story."""
        self._add(self._speaker, text)

    def find(self, kind: str, text: str) -> None:
        """Report that something is wrong, which ends the world."""
        self.kernel.find(kind, text)

    def end(self) -> None:
        """End the world: all is done."""
        self.kernel.over = self.kernel.over or DONE

    def every(self, period: float, look: Callable[[], object]) -> None:
        """Call `look` every `period` s from outside of the world: while it runs, nobody else does.

        It must not wait. What it calls passes all locks.
        """

        def turn() -> None:
            look()
            self.kernel.after(period, turn)

        self.kernel.after(period, turn)

    def watch(self, look: Callable[[], str | None], kind: str, period: float = 0.002) -> None:
        """Judge the world every `period` s from outside.

        Args:
            look: returns what is wrong, or nothing; see `every`.
            kind: of the finding.
            period: s between two looks.
        """

        def judge() -> None:
            if text := look():
                self.find(kind, text)

        self.every(period, judge)

    def start(self, name: str, function: Callable[[], object]) -> Process:
        """Start a process in which `function` runs; it ends with it."""
        process = self.kernel.add_process(name)
        process.main = self.kernel.start("main", lambda _: run_main(function), process)
        return process

    def join(self, process: Process) -> None:
        """Wait until a process has ended."""
        while process.alive:
            self.kernel.wait((process.exited,))

    @property
    def now(self) -> float:
        """Monotonic clock, s; looking costs no time and lets nobody else go on."""
        return self.kernel.now / kernels.NS

    @property
    def story(self) -> tuple[Line, ...]:
        """What has happened by now."""
        return tuple(self._story)

    # The run

    def run(self, scenario: Scenario) -> Outcome:
        """Run a scenario to its end, or to that of the world."""
        kernels.begin(self.kernel)
        begin_network(self.network)
        process = self.kernel.add_process("main")
        threading.excepthook = self._thread_died
        root = logging.getLogger()
        root.handlers[:] = [_ToStory(self)]
        random.seed(self.kernel.seed)

        returned: list[object] = []

        def main() -> None:
            be_main_thread(process)
            try:
                returned.append(scenario(self))
            except SystemExit as end:
                self.find(
                    "a process died", f"the scenario called sys.exit({end.code!r}): let it return"
                )

        self.kernel.run(main, process)
        kernel = self.kernel
        return Outcome(
            seed=kernel.seed,
            over=kernel.over,
            hash=kernel.hash,
            findings=tuple(Finding(*each) for each in kernel.findings),
            story=self.story,
            troubles=self.troubles.count,
            without=tuple(each for each in self._without if each < self.troubles.count),
            struck=dict(self.troubles.struck),
            virtual=kernel.seconds,
            cpu=kernel.cpu,
            switches=kernel.switches,
            packets=self.network.packets,
            result=returned[0] if returned else None,
        )

    @property
    def _speaker(self) -> str:
        """Process and thread that speak."""
        return "the world" if self.kernel.current is None else str(self.kernel.current)

    def _add(self, who: str, text: str) -> None:
        self._story.append(Line(self.kernel.seconds, who, text[:_LONGEST_LINE]))

    def _tell_trouble(self, text: str) -> None:
        self._add("TROUBLE", text)

    def tell_record(self, record: logging.LogRecord) -> None:
        """Add what a program has logged."""
        self._add(self._speaker, f"{record.levelname} {record.getMessage()}")

    def _thread_died(self, what: Any) -> None:
        if issubclass(what.exc_type, SystemExit):
            return  # as a thread of Python ends by it
        lines = traceback.format_exception(what.exc_type, what.exc_value, what.exc_traceback)
        name = what.thread.name if what.thread else "?"
        self.find("a thread died", f"{self.kernel.process.name}/{name}: {''.join(lines)}")


class _ToStory(logging.Handler):
    def __init__(self, world: World) -> None:
        super().__init__(logging.WARNING)
        self._world = world

    @override
    def emit(self, record: logging.LogRecord) -> None:
        self._world.tell_record(record)
