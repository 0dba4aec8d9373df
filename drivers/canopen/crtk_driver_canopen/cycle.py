"""The cyclic path: SYNC out, TPDOs in, RPDOs out; what came in time and what did not.

In each cycle the nodes take over the RPDOs of the last one and sample their TPDOs at the same instant, the
SYNC. `Cycle.begin` sends it or, where the kernel sends it (SocketCAN), waits for it to pass; `Cycle.collect`
receives until every synchronous TPDO is there or the time is over; `Cycle.send` sends the RPDOs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import can

from crtk_driver_canopen.answers import SyncAnswers
from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.bus_state import bus_lost, condition_of_error
from crtk_driver_canopen.frames import Frame
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.pdo import Pdo, PdoGroup, check_cob_ids
from crtk_driver_canopen.ports import message_of

SYNC: Final = 0x080

_SPARE: Final = 3
"""SYNCs of the kernel that may come beyond one in each period: the one at the begin, and for rounding."""

_COUNTED: Final = 5.0
"""Seconds in which SYNCs are counted; the kernel's are a little rarer than asked for, which adds up."""

_WAITED: Final = 0.0005
"""Seconds after which a frame has been waited for: there was nothing left to be received."""

_DRAINED: Final = 512
"""Frames that are taken from before a SYNC at most: a bus that never rests does not hold a cycle up."""


@dataclass(slots=True)
class CycleCounters:
    """What happened in the cycles so far.

    Attributes:
        cycles: SYNCs.
        late: TPDOs that came after their cycle.
        missed: TPDOs that had not come in their cycle.
        short: TPDOs with too few bytes; they are not taken.
        foreign_syncs: SYNCs of somebody else.
        overruns: SYNCs of the kernel that passed while the last cycle was still going on.
        unsent: cycles whose RPDOs could not all be sent.
    """

    cycles: int = 0
    late: int = 0
    missed: int = 0
    short: int = 0
    foreign_syncs: int = 0
    overruns: int = 0
    unsent: int = 0


class SyncSource(Protocol):
    """Who produces the SYNC."""

    own: bool
    """Whether our own SYNC is received as well (`Frame.own`), and marks the begin of a cycle."""

    def is_ours(self, frame: Frame, now: float, awaited: bool) -> bool:
        """Take note of a SYNC that was received at monotonic seconds; return whether it can be ours."""
        ...

    def start(self) -> None:
        """Begin."""
        ...

    def send(self) -> bool:
        """Send one now, if that is how it is produced; return whether there was room."""
        ...

    def stop(self) -> None:
        """End."""
        ...


def _sync_frames(overflow: int) -> list[Frame]:
    """Return the SYNCs in turn: one without data, or those with the counter from 1 on (CiA 301, 7.2.5)."""
    if not overflow:
        return [Frame(SYNC, b"")]
    return [Frame(SYNC, bytes([count])) for count in range(1, overflow + 1)]


class SentSync:
    """Sends a SYNC at each `Cycle.begin`, which the caller times.

    Args:
        overflow: highest value of the counter (1019), 2 to 240; 0: SYNC has none.
    """

    own = False

    def __init__(self, link: CanLink, overflow: int = 0) -> None:
        self._link = link
        self._frames = _sync_frames(overflow)
        self._next = 0

    def is_ours(self, frame: Frame, now: float, awaited: bool) -> bool:
        """Return False: ours does not come back."""
        return False

    def start(self) -> None:
        """Begin with the counter at 1."""
        self._next = 0

    def send(self) -> bool:
        """Send the next SYNC."""
        frame = self._frames[self._next]
        self._next = (self._next + 1) % len(self._frames)
        return self._link.send(frame)

    def stop(self) -> None:
        """End."""


class KernelSync:
    """Has the kernel send the SYNC (the broadcast manager of SocketCAN), on its own clock.

    On another interface python-can does it, in a thread. The bus must receive what is sent from this
    computer, as SocketCAN does from another socket; elsewhere open it with ``receive_own_messages``.

    Args:
        period: between two, in s.
        overflow: highest value of the counter (1019), 2 to 240; 0: SYNC has none.
    """

    own = True  # it comes back marked as sent by this computer

    def __init__(self, link: CanLink, period: float, overflow: int = 0) -> None:
        self._link = link
        self._period = period
        self._messages = [message_of(frame) for frame in _sync_frames(overflow)]
        self._task: can.broadcastmanager.CyclicSendTaskABC | None = None
        self._began = self._heard = 0.0
        self._received = 0

    def is_ours(self, frame: Frame, now: float, awaited: bool) -> bool:
        """Take note of a SYNC; return whether it can be ours.

        SocketCAN does not tell which program on this computer sent a frame. But the kernel sends at most one
        SYNC in a period: what comes beyond that, however late it is read, is somebody else's.

        Args:
            frame: the SYNC.
            now: monotonic seconds at which it was received.
            awaited: nothing that had come before was still to be received.
        """
        if not frame.own:
            return False
        before, self._heard = self._heard, now
        is_in_time = awaited and now - before < 2.0 * self._period  # else others lie behind it
        if is_in_time and now - self._began > _COUNTED:
            self._began, self._received = now, 0
        if self._received >= (now - self._began) / self._period + _SPARE:
            return False
        self._received += 1
        return True

    def start(self) -> None:
        """Begin.

        Raises:
            BusLost: the kernel refuses.
        """
        self.stop()
        self._began, self._received = time.monotonic(), 0
        try:
            self._task = self._link.bus.send_periodic(
                self._messages, self._period, store_task=False
            )
        except (can.CanError, OSError) as error:
            raise bus_lost(condition_of_error(error), str(error), self._link.where) from error

    def send(self) -> bool:
        """Leave it to the kernel."""
        return True

    def stop(self) -> None:
        """End."""
        task, self._task = self._task, None
        if task is not None:
            task.stop()


class Cycle:
    """The PDOs of all nodes on one bus. Belongs to the thread that owns the link.

    Args:
        master: of the bus.
        tpdos: what the nodes send.
        rpdos: what they are sent.
        sync: who produces the SYNC.

    Attributes:
        counters: see `CycleCounters`.
        ages: of each TPDO, the cycles since it last came: 0 in the cycle in which it did.
        received: of each TPDO, monotonic seconds at which it last came; 0 before.
        answers: which SYNC the TPDOs answer.

    Raises:
        ConfigError: two PDOs have one COB-ID, or one has that of something else.
    """

    def __init__(self, master: Master, tpdos: PdoGroup, rpdos: PdoGroup, sync: SyncSource) -> None:
        check_cob_ids([*tpdos.pdos, *rpdos.pdos])
        self.master = master
        self.tpdos = tpdos
        self.rpdos = rpdos
        self.sync = sync
        self.counters = CycleCounters()
        self.ages = [0] * len(tpdos)
        self.received = [0.0] * len(tpdos)
        self._link = master.link
        self._data = [bytes(size) for size in tpdos.sizes]
        self._seen = [False] * len(tpdos)
        self._cob_ids = [pdo.id for pdo in rpdos.pdos]
        # Those that come with every SYNC are waited for, the others taken when they come.
        self._every = tuple(pdo.transmission == 1 for pdo in tpdos.pdos)
        self._open: set[int] = set()
        self.answers = SyncAnswers(
            [
                pdo.node if every else None
                for pdo, every in zip(tpdos.pdos, self._every, strict=True)
            ]
        )

    def start(self) -> None:
        """Forget what was received before, and let SYNCs begin.

        Raises:
            BusLost: the bus cannot be used.
        """
        self.ages = [0] * len(self.tpdos)
        self._seen = [False] * len(self.tpdos)
        self._open.clear()
        self.answers.start()
        self.sync.start()

    def stop(self) -> None:
        """End the SYNCs, if they are not sent from here."""
        self.sync.stop()

    @property
    def complete(self) -> bool:
        """Whether every TPDO has come at least once since `start`."""
        return all(self._seen)

    @property
    def values(self) -> tuple[int, ...]:
        """Last values of all entries of all TPDOs, in order; see `PdoGroup.places`."""
        return self.tpdos.unpack(self._data)

    def begin(self, deadline: float) -> bool:
        """Begin a cycle: send the SYNC, or wait for that of the kernel; then what else is to be sent.

        Args:
            deadline: monotonic seconds; only for the kernel's.

        Returns:
            Whether there was one.

        Raises:
            BusLost: the bus cannot be used.
        """
        if self.sync.own:
            begun = self._wait_for_sync(deadline)
        else:
            self._drain()
            begun = self.sync.send()
            if begun:
                self.answers.sync(time.monotonic())
        if begun:
            self.counters.cycles += 1
            self.ages = [age + 1 for age in self.ages]
            self._open = {slot for slot, every in enumerate(self._every) if every}
        self.master.tick(time.monotonic())
        self._link.send_posted()
        return begun

    def collect(self, deadline: float, most: float = math.inf) -> bool:
        """Receive until every TPDO that comes with each SYNC is there.

        Args:
            deadline: monotonic seconds.
            most: seconds for which what other threads post may wait; as long as it takes if infinite.

        Returns:
            Whether they all came.

        Raises:
            BusLost: the bus cannot be used.
        """
        receive, take, monotonic = self._link.receive, self._take, time.monotonic
        now = monotonic()
        while self._open and now < deadline:
            frame = receive(min(deadline - now, most))
            now = monotonic()
            if frame is not None:
                take(frame, now)
            if most < math.inf:
                self._link.send_posted()
        self.counters.missed += len(self._open)
        return not self._open

    def serve(self, deadline: float, most: float, needed: Callable[[], bool]) -> None:
        """Go on receiving, and sending what other threads post.

        Args:
            deadline: monotonic seconds.
            most: seconds for which what they post may wait.
            needed: whether to go on; asked after each frame.

        Raises:
            BusLost: the bus cannot be used.
        """
        while needed() and (now := time.monotonic()) < deadline:
            frame = self._link.receive(min(deadline - now, most))
            if frame is not None:
                self._take(frame, time.monotonic())
            self._link.send_posted()

    def send(self, values: Sequence[float]) -> bool:
        """Send all RPDOs.

        Args:
            values: of all entries of all RPDOs, in order; see `PdoGroup.places`.

        Returns:
            Whether there was room for all.

        Raises:
            BusLost: the bus cannot be used, or has had no room for several cycles.
            struct.error: a value does not fit into its object.
        """
        complete = self._link.send(*map(Frame, self._cob_ids, self.rpdos.pack(values)))
        self.counters.unsent += not complete
        self._link.end_cycle(complete)
        return complete

    def stale(self, cycles: int) -> list[Pdo]:
        """Return the synchronous TPDOs that have not come for more than `cycles` of their turns."""
        return [
            pdo
            for pdo, age in zip(self.tpdos.pdos, self.ages, strict=True)
            if pdo.synchronous and age > cycles * max(1, pdo.transmission)
        ]

    def _wait_for_sync(self, deadline: float) -> bool:
        while (now := time.monotonic()) < deadline:
            frame = self._link.receive(deadline - now)
            if frame is None:
                continue
            then, now = now, time.monotonic()
            if frame.can_id != SYNC:
                self._take(frame, now, late=True)
            elif self._is_our_sync(frame, now, awaited=now - then > _WAITED):
                return True
        return False

    def _is_our_sync(self, frame: Frame, now: float, *, awaited: bool = False) -> bool:
        ours = self.sync.is_ours(frame, now, awaited)
        self.counters.foreign_syncs += not ours
        if ours:
            self.answers.sync(now)
        return ours

    def _drain(self) -> None:
        """Take what came since the last cycle."""
        for _ in range(_DRAINED):
            frame = self._link.receive(0.0)
            if frame is None:
                return
            self._take(frame, time.monotonic(), late=True)

    def _take(self, frame: Frame, now: float, late: bool = False) -> None:
        slot = self.tpdos.slots.get(frame.can_id)
        if slot is None:
            if frame.can_id == SYNC:
                self.counters.overruns += self._is_our_sync(frame, now)
            else:
                self._link.dispatch(frame, now)
            return
        size = self.tpdos.sizes[slot]
        data = frame.data
        if len(data) != size:
            if len(data) < size:
                self.counters.short += 1
                return
            data = data[:size]
        self._data[slot] = data
        self._seen[slot] = True
        self.answers.take(slot)
        self.ages[slot] = 0
        self.received[slot] = now
        if late:
            self.counters.late += self._every[slot]
        self._open.discard(slot)
