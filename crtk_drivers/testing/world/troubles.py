"""What goes wrong in a world: bad weather on its network, and faults at chosen moments.

All of it is drawn from the seed, when the world begins or as its script goes on, and each has a number. A
world can be run again without some of them: so a failure is reduced to those that it needs.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

from crtk_drivers.testing.world.machine.endpoints import Endpoint
from crtk_drivers.testing.world.machine.kernel import NS, Kernel, Process
from crtk_drivers.testing.world.machine.network import Network

LENGTHS: Final = (0.01, 0.1, 0.4, 1.5)
"""s that a fault lasts, one of them, times 0.5 to 1.5."""
_BASES: Final = (20e-6, 100e-6, 1e-3)
_MOMENT: Final = 20e-6
LATENESS: Final = (0.005, 0.05, 0.3)
"""s by which a packet comes late at most, one of them."""


@dataclass(slots=True)
class Weather:
    """What a network does to what is sent.

    Attributes:
        base: s that a packet takes, times 0.5 to 1.5.
        late: share of packets that come later, by up to `lateness` s.
        lost: share of datagrams.
        doubled: share of datagrams that come twice.
        cut: share of pieces of a stream that come in two.
        blocked_until: ns; nothing passes before.
    """

    kernel: Kernel
    random: random.Random
    base: float = 100e-6
    late: float = 0.0
    lateness: float = 0.005
    lost: float = 0.0
    doubled: float = 0.0
    cut: float = 0.0
    blocked_until: int = 0

    def handshake(self) -> float:
        """Return the s that one way takes."""
        seconds = self.base * (0.5 + self.random.random())
        if self.random.random() < self.late:
            seconds += self.random.random() * self.lateness
        return seconds + max(0, self.blocked_until - self.kernel.now) / NS

    def moment(self) -> float:
        """Return the s that something takes within the machine."""
        return _MOMENT * (0.5 + self.random.random())

    def stream_piece(self, size: int) -> tuple[float, int]:
        """Return the s that a piece of a stream takes, and where it is cut in two (0: nowhere)."""
        seconds = self.handshake()
        is_cut = size > 1 and self.random.random() < self.cut
        return seconds, self.random.randrange(1, size) if is_cut else 0

    def datagram(self) -> list[float]:
        """Return the s after which a datagram arrives, of each copy; empty if it is lost."""
        if self.kernel.now < self.blocked_until or self.random.random() < self.lost:
            return []
        copies = 2 if self.random.random() < self.doubled else 1
        return [self.handshake() for _ in range(copies)]


@dataclass(frozen=True, slots=True)
class _Trait:
    """Bad weather of one kind.

    Attributes:
        name: of the attribute of `Weather`.
        chance: that a world has it.
        most: its greatest share.
        text: what is said of it.
    """

    name: str
    chance: float
    most: float
    text: str


_TRAITS: Final = (
    _Trait("late", 0.4, 0.02, "packets come late"),
    _Trait("lost", 0.4, 0.05, "datagrams are lost"),
    _Trait("doubled", 0.3, 0.02, "datagrams come twice"),
    _Trait("cut", 0.3, 0.02, "pieces of a stream come in two"),
)
_STALLS: Final = "threads are kept from running"


class Troubles:
    """All that goes wrong in one world.

    Args:
        kernel, network: of the world.
        tell: is given what happens, for the story.
        without: numbers of troubles that are left out.

    Attributes:
        count: of the troubles that were drawn, those left out among them.
        struck: how many took effect, by kind.
    """

    def __init__(
        self,
        kernel: Kernel,
        network: Network[Endpoint],
        weather: Weather,
        tell: Callable[[str], None],
        without: Collection[int] = (),
    ) -> None:
        self._kernel = kernel
        self._network = network
        self._weather = weather
        self._tell = tell
        self._without = frozenset(without)
        self._random = kernel.stream("troubles")
        self._moments = kernel.stream("moments")
        self.count = 0
        self.struck: Counter[str] = Counter()

    @property
    def is_blocked(self) -> bool:
        """Whether the network lets nothing pass now."""
        return self._weather.blocked_until >= self._kernel.now

    def _admits(self) -> int | None:
        """Give the next trouble its number; None if it is left out."""
        number, self.count = self.count, self.count + 1
        return None if number in self._without else number

    def draw_weather(self) -> None:
        """Let the network, and the threads' turns, be as they are on bad days."""
        draw = self._random
        self._weather.base = draw.choice(_BASES)
        self._weather.lateness = draw.choice(LATENESS)
        for trait in _TRAITS:
            has_it, share = draw.random() < trait.chance, draw.random() * trait.most
            if has_it and (number := self._admits()) is not None:
                setattr(self._weather, trait.name, share)
                self.struck[trait.text] += 1
                late = f" by up to {self._weather.lateness:g} s" if trait.name == "late" else ""
                self._tell(f"[{number}] {trait.text}{late}: {100.0 * share:.2g} %")
        stall = draw.choice((0.0, 0.0003, 0.002))
        if stall and (number := self._admits()) is not None:
            self._kernel.stall_share = stall
            self.struck[_STALLS] += 1
            self._tell(f"[{number}] {_STALLS} for up to 0.03 s: {100.0 * stall:.2g} %")

    def storm(self, begin: float, end: float, most: int, kinds: Sequence[str] = ()) -> None:
        """Let faults come at random times.

        Args:
            begin, end: between these two times, in s from now.
            most: how many at most.
            kinds: some of `FAULTS`; all if empty.
        """
        draw = self._random
        for _ in range(draw.randrange(most + 1)):
            self._plan(begin + (end - begin) * draw.random(), draw, kinds)

    def block(self, delay: float, seconds: float) -> None:
        """Let the network pass nothing for so many s, `delay` s from now."""
        number = self._admits()
        if number is not None:
            self._kernel.after(delay, lambda: self._strike(number, "block", seconds, 0.0))

    def around(self, seconds: float, chance: float = 0.3) -> None:
        """Let a fault come within so many s from now, by chance: something important happens meanwhile."""
        draw = self._moments
        is_chosen, delay = draw.random() < chance, seconds * draw.random()
        if is_chosen:
            self._plan(delay, draw)

    def _plan(self, delay: float, draw: random.Random, kinds: Sequence[str] = ()) -> None:
        name = draw.choice(kinds or FAULTS)
        seconds = draw.choice(LENGTHS) * (0.5 + draw.random())
        chosen = draw.random()
        number = self._admits()
        if number is not None:
            self._kernel.after(delay, lambda: self._strike(number, name, seconds, chosen))

    def _strike(self, number: int, name: str, seconds: float, chosen: float) -> None:
        text = _FAULTS[name](self, seconds, chosen)
        self._kernel.note("trouble", number, name)
        if text:
            self.struck[name] += 1
            self._tell(f"[{number}] {text}")

    # What can strike; `chosen`, from 0 to 1, picks one of several victims. Without a victim, no text.

    def _block(self, seconds: float, _: float) -> str:
        self._weather.blocked_until = self._kernel.now + int(seconds * NS)
        return f"the network is blocked for {seconds:.3g} s"

    def _reset(self, _: float, chosen: float) -> str:
        streams = self._network.streams
        if not streams:
            return ""
        victim = streams[int(chosen * len(streams))]
        victim.reset()
        return f"the connection {victim.name} to {victim.peer_name} is reset"

    def _freeze_process(self, seconds: float, chosen: float) -> str:
        alive = [process for process in self._kernel.processes if process.alive]
        return self._freeze(alive[int(chosen * len(alive))], seconds)

    def _freeze(self, process: Process, seconds: float) -> str:
        self._kernel.freeze(process, seconds)
        return f"the process {process.name} stands still for {seconds:.3g} s"

    def _freeze_thread(self, seconds: float, chosen: float) -> str:
        alive = [
            task
            for task in self._kernel.tasks
            if task.process.alive and not task.ended and task is not task.process.main
        ]
        if not alive:
            return ""
        victim = alive[int(chosen * len(alive))]
        self._kernel.freeze(victim, seconds)
        return f"the thread {victim} stands still for {seconds:.3g} s"

    def _step_clock(self, seconds: float, chosen: float) -> str:
        step = int((chosen - 0.5) * 2.0 * 3600.0 * NS)
        self._kernel.wall_offset += step
        return f"the wall clock is set by {step / NS:+.1f} s"


WEATHER: Final = (*(trait.text for trait in _TRAITS), _STALLS)
"""Kinds of bad weather, as they are counted."""
_FAULTS: Final[dict[str, Callable[[Troubles, float, float], str]]] = {
    "block": Troubles._block,  # noqa: SLF001 - this table belongs to the class
    "reset": Troubles._reset,  # noqa: SLF001
    "freeze process": Troubles._freeze_process,  # noqa: SLF001
    "freeze thread": Troubles._freeze_thread,  # noqa: SLF001
    "step clock": Troubles._step_clock,  # noqa: SLF001
}
FAULTS: Final = tuple(_FAULTS)
"""Kinds of faults, as they are counted."""
