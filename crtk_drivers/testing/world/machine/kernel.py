"""The scheduler of a world: virtual time, threads of which one runs at a time, one seed, one hash.

A task is a real Python thread that waits at a gate of its own. Whoever waits opens the gate of the next task.
Which task that is comes from a generator that the seed makes. When no task can run, time jumps to the next
event. Every choice and every packet goes into one hash, so that two runs can be compared.

This module is imported before anything is patched, and takes the real locks and clocks with it.
"""

from __future__ import annotations

import _thread
import hashlib
import heapq
import math
import random
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol

from typing_extensions import override

NS: Final = 1_000_000_000
BOOT: Final = 1000 * NS
"""Of the monotonic clock, at the beginning of a world."""
EPOCH: Final = 1_900_000_000 * NS
"""Of the wall clock, when the monotonic clock is 0: a day in 2030."""
FOR_EVER: Final = 1 << 62
DONE: Final = "done"
"""Why a world has ended in which nothing was found."""
READ_COST: Final = 300
"""ns that a look at a clock takes: a loop that spins until a deadline comes to its end."""
_LEAST_SWITCH: Final = 1_000
"""ns that it takes at least until the next task runs."""
_SWITCH_SPREAD: Final = 14_000
"""ns that it may take longer."""
_PIECE: Final = 2000
"""Bytes that are hashed at once: for more, hashlib lets go of the interpreter's lock, which is slow."""

_allocate_gate, _start_thread, _real_cpu, _get_ident = (
    _thread.allocate_lock,
    _thread.start_new_thread,
    time.process_time,
    _thread.get_ident,
)

Waiters = dict["Task", None]
"""Who waits for one thing, in the order in which they came."""


class NotSimulated(RuntimeError):
    """A program in a world asked for something that the world does not have; it names that."""


class File(Protocol):
    """What a descriptor of a process leads to."""

    def drop(self) -> None:
        """Count one descriptor less; the last one closes it."""


class Process:
    """What lives and dies together: threads and descriptors.

    Attributes:
        pid: process id in the world.
        argv: its command line.
        files: by descriptor.
        handlers: of signals, by number.
        frozen_until: ns; none of its tasks runs before.
        vanished: its machine has gone: it answers nothing.
        exit_code: None while it lives.
        exited: who waits for its end.
        parent: that has started it.
        is_stopped: by SIGSTOP.
        delayed: signals that came meanwhile.
        is_reaped: its parent knows how it has ended, and nobody finds it any more.
        at_exit: what `atexit` was given.
        ended: called at its end, however that comes, in no task.
        standard: its ``sys.stdin``, ``sys.stdout`` and ``sys.stderr``.
    """

    def __init__(self, pid: int, name: str, argv: Iterable[str] = ()) -> None:
        self.pid = pid
        self.name = name
        self.argv = list(argv) or [name]
        self.files: dict[int, File] = {}
        self.handlers: dict[int, Any] = {}
        self.pending: list[int] = []
        self.main: Task | None = None
        self.main_thread: Any = None
        self.frozen_until = 0
        self.vanished = False
        self.exit_code: int | None = None
        self.exited: Waiters = {}
        self.parent: Process | None = None
        self.is_stopped = self.is_reaped = False
        self.delayed: list[int] = []
        self.at_exit: list[Callable[[], object]] = []
        self.ended: list[Callable[[], object]] = []
        self.standard = sys.stdin, sys.stdout, sys.stderr

    @property
    def alive(self) -> bool:
        """Whether it has not ended."""
        return self.exit_code is None


class Task:
    """A thread of the world.

    Attributes:
        wants: the lock that it waits for without end.
        thread: of `threading`, if it is one.
        frozen_until: ns; it does not run before.
    """

    def __init__(self, number: int, name: str, process: Process) -> None:
        self.number = number
        self.name = name
        self.process = process
        self.gate = _allocate_gate()
        self.gate.acquire()
        self.ready = self.ended = False
        self.frozen_until = 0
        self.turn = 0  # counts waits: a timer of an earlier one does nothing
        self.wants: Any = None
        self.sentinel: Any = None  # released at its end
        self.ident = 0
        self.thread: Any = None

    @override
    def __repr__(self) -> str:
        return f"{self.process.name}/{self.name}"


class Kernel:
    """The machine of one world.

    Args:
        seed: of all that happens.
        preempt: share of the points of preemption at which another task goes on.
        stall: share of them at which the task is kept from running for up to 30 ms.
        horizon: s after which the world ends.

    Attributes:
        now: ns of the monotonic clock.
        entropy: what a program is given that asks the system for random numbers.
        wall_offset: ns that the wall clock was set forward.
        current: the task that runs; None while an event is carried out, which belongs to no task.
        over: why the world has ended; empty while it goes on.
        findings: what was wrong: kind, time in s, text.
        log: every line of the trace, if it is a list.
    """

    def __init__(
        self,
        seed: int,
        *,
        preempt: float = 0.0,
        stall: float = 0.0,
        horizon: float = 60.0,
    ) -> None:
        self.seed = seed
        self._random = self.stream("schedule")
        self.entropy = self.stream("entropy")
        self.now = BOOT
        self.wall_offset = 0
        self.preempt_share = preempt
        self.stall_share = stall
        self._horizon = BOOT + int(horizon * NS)
        self.tasks: list[Task] = []
        self.processes: list[Process] = []
        self._runnable: list[Task] = []
        self._timers: list[tuple[int, int, Callable[[], object]]] = []
        self._count = 0
        self.current: Task | None = None
        self.over = ""
        self.findings: list[tuple[str, float, str]] = []
        self._hash = hashlib.blake2b(digest_size=8)
        self.log: list[str] | None = None
        self.switches = 0
        self.cpu = 0.0
        self._quiet = 0
        self._done = _allocate_gate()
        self._done.acquire()

    def stream(self, purpose: str) -> random.Random:
        """Return a generator of this seed for one purpose; what others draw does not change it."""
        return random.Random(f"{self.seed} {purpose}")

    def draw_anew(self, purpose: str) -> None:
        """Draw what is random from here on by the seed and a purpose, whatever was drawn before."""
        self._random = self.stream(f"schedule {purpose}")
        self.entropy = self.stream(f"entropy {purpose}")
        self._quiet = self._draw_quiet()

    # Time

    @property
    def seconds(self) -> float:
        """Since the beginning of the world."""
        return (self.now - BOOT) / NS

    def at(self, when: int, function: Callable[[], object]) -> None:
        """Call `function` at a time (ns). It runs in no task, so it must not wait."""
        self._count += 1
        heapq.heappush(self._timers, (when, self._count, function))

    def after(self, seconds: float, function: Callable[[], object]) -> None:
        """Call `function` so many seconds from now. It runs in no task, so it must not wait."""
        self.at(self.now + int(seconds * NS), function)

    def read_clock(self) -> int:
        """Return ns of the monotonic clock, for a program."""
        if self.current is not None:
            self.now += READ_COST
            self.preempt()
        return self.now

    def allow(self, seconds: float) -> None:
        """Let the world go on for so many seconds from now, and no longer."""
        self._horizon = self.now + int(seconds * NS)

    def deadline(self, timeout: float | None) -> int | None:
        """Return when a timeout (s) is over, in ns; None if it never is."""
        return None if timeout is None or timeout < 0 else self.now + int(timeout * NS)

    # The trace

    def note(self, *what: object) -> None:
        """Add a line to the trace."""
        self._trace(f"{self.now} {what!r}\n".encode())

    def _trace(self, line: bytes) -> None:
        for begin in range(0, len(line), _PIECE):
            self._hash.update(line[begin : begin + _PIECE])
        if self.log is not None:
            self.log.append(line.decode().rstrip())

    @property
    def hash(self) -> str:
        """Of the trace by now."""
        return self._hash.hexdigest()

    def find(self, kind: str, text: str) -> None:
        """Add a finding, and end the world."""
        self.note("found", kind)
        self.findings.append((kind, self.seconds, text))
        self.over = self.over or kind

    # Processes and tasks

    @property
    def process(self) -> Process:
        """Whose task runs; the first process while none does."""
        return self.processes[0] if self.current is None else self.current.process

    def add_process(self, name: str, argv: Iterable[str] = ()) -> Process:
        """Make a process without a task."""
        found = Process(4000 + len(self.processes), name, argv)
        self.processes.append(found)
        return found

    def start(self, name: str, function: Callable[[Task], object], process: Process) -> Task:
        """Make a task that is ready to run."""
        task = Task(len(self.tasks), name, process)
        self.tasks.append(task)

        def body() -> None:
            task.ident = _get_ident()
            task.gate.acquire()
            try:
                function(task)
            except SystemExit:
                pass  # as a thread of Python ends by it
            except BaseException:
                self.find("a thread died", f"{task}: {traceback.format_exc()}")
            task.ended = True
            if task.sentinel is not None:
                task.sentinel.release()
            self._hand_on(None)

        _start_thread(body, ())
        self._make_ready(task)
        return task

    def end_process(self, process: Process, code: int, *, silently: bool = False) -> None:
        """End a process at once: its tasks never run again, and the system closes its files.

        Args:
            process: it.
            code: that whoever waits for it is given.
            silently: its machine has gone: nobody is told, and nothing is closed.
        """
        if not process.alive:
            return
        process.exit_code = code
        process.vanished = silently
        self.note("end", process.name, code, silently)
        if not silently:
            files, process.files = process.files, {}
            for file in files.values():
                file.drop()
        for tell in process.ended:
            tell()
        self.wake(process.exited)
        if self.current is not None and self.current.process is process:
            self._hand_on(self.current)  # and never back

    def send_signal(self, process: Process, number: int) -> None:
        """Let the main task of a process run the handler of a signal."""
        process.pending.append(number)
        if process.main is not None:
            self._make_ready(process.main)

    def _make_ready(self, task: Task) -> None:
        if not (task.ready or task.ended):
            task.ready = True
            self._runnable.append(task)

    def wake(self, waiters: Waiters) -> None:
        """Let tasks look again whether they have what they wait for."""
        for task in waiters:
            self._make_ready(task)

    def wait(self, queues: Iterable[Waiters], until: int | None = None) -> None:
        """Give up the processor until one of `queues` is woken, or until a time (ns).

        It may also end for no reason: whoever waits looks again.
        """
        task = self.current
        if task is None:
            raise NotSimulated("waiting in an event, which belongs to no task")
        queues = tuple(queues)
        task.turn += 1
        turn = task.turn
        for queue in queues:
            queue[task] = None
        if until is not None:
            self.at(max(until, self.now + 1), lambda: self._time_out(task, turn))
        self._hand_on(task)
        for queue in queues:
            queue.pop(task, None)
        task.turn += 1
        if task.process.pending and task is task.process.main:
            self._handle_signals(task.process)

    def _time_out(self, task: Task, turn: int) -> None:
        if task.turn == turn:
            self._make_ready(task)

    @staticmethod
    def _handle_signals(process: Process) -> None:
        while process.pending:
            number = process.pending.pop(0)
            handler = process.handlers.get(number)
            if callable(handler):
                handler(number, None)

    def preempt(self) -> None:
        """Let another task go on here, now and then."""
        if self._quiet > 0:
            self._quiet -= 1
            return
        task = self.current
        if task is None:
            return
        self._quiet = self._draw_quiet()
        if self._random.random() * (self.stall_share + self.preempt_share) < self.stall_share:
            task.frozen_until = self.now + int(self._random.random() * 0.03 * NS)
            self.at(task.frozen_until, _nothing)
        self.give_way()

    def _draw_quiet(self) -> int:
        """Return how many points of preemption pass before the next at which a task is held up.

        One number is drawn for many points: there are far more of them than of anything else.
        """
        share = self.stall_share + self.preempt_share
        if share <= 0.0:
            return FOR_EVER
        if share >= 1.0:
            return 0
        return int(math.log(1.0 - self._random.random()) / math.log(1.0 - share))

    def give_way(self) -> None:
        """Let another task go on; the current one stays ready."""
        task = self.current
        if task is not None:
            self._make_ready(task)
            self._hand_on(task)
            if task.process.pending and task is task.process.main:
                self._handle_signals(task.process)

    def _hand_on(self, task: Task | None) -> None:
        following = self._choose()
        if following is task is not None:
            return
        if following is None:
            self._done.release()
        else:
            if self.current is None:
                sys.argv = following.process.argv
            elif self.current.process is not following.process:
                self._switch(self.current.process, following.process)
            self.current = following
            following.gate.release()
        if task is not None:
            task.gate.acquire()

    @staticmethod
    def _switch(before: Process, after: Process) -> None:
        """Let `sys` have what differs between processes."""
        before.standard = sys.stdin, sys.stdout, sys.stderr
        sys.stdin, sys.stdout, sys.stderr = after.standard
        sys.argv = after.argv

    def _choose(self) -> Task | None:
        """Return the next task; time goes on to the next event as often as none can run."""
        while not self.over:
            while self._timers and self._timers[0][0] <= self.now:
                self._call(heapq.heappop(self._timers)[2])
            able = self._able()
            if able:
                count = len(able)
                task = able[int(self._random.random() * count)] if count > 1 else able[0]
                self._runnable.remove(task)
                task.ready = False
                self.now += _LEAST_SWITCH + int(self._random.random() * _SWITCH_SPREAD)
                self.switches += 1
                self._trace(b"%d %d %d\n" % (self.now, task.number, count))
                return task
            if not self._timers:
                self.find(
                    "all wait for ever", self.stacks() or "no thread is left to end the scenario"
                )
            elif self._timers[0][0] > self._horizon:
                self.find("not done at the horizon", self.stacks())
            else:
                self.now = max(self.now, self._timers[0][0])
        return None

    def _call(self, function: Callable[[], object]) -> None:
        task, self.current = self.current, None
        try:
            function()
        except Exception:
            self.find("the world is broken", traceback.format_exc())
        finally:
            self.current = task

    def _able(self) -> list[Task]:
        """Return the tasks that may run now. This is called at each switch, so it is written to be fast."""
        now = self.now
        return [
            task
            for task in self._runnable
            if task.frozen_until <= now
            and task.process.frozen_until <= now
            and task.process.exit_code is None
        ]

    # Faults

    def freeze(self, what: Task | Process, seconds: float) -> None:
        """Let a task or a whole process stand still, for ever if `seconds` is infinite."""
        self.note("freeze", what.name, seconds)
        if seconds == float("inf"):
            what.frozen_until = FOR_EVER
        else:
            what.frozen_until = self.now + int(seconds * NS)
            self.at(what.frozen_until, _nothing)

    def thaw(self, what: Task | Process) -> None:
        """Let what was frozen go on."""
        what.frozen_until = 0
        self.at(self.now, _nothing)

    # The run

    def run(self, main: Callable[[], object], process: Process) -> None:
        """Run `main` as the first task until it has returned or the world has ended."""

        def first(_: Task) -> None:
            main()
            self.over = self.over or DONE

        process.main = self.start("main", first, process)
        self._quiet = self._draw_quiet()
        cpu = _real_cpu()
        self._hand_on(None)
        self._done.acquire()
        self.cpu = _real_cpu() - cpu

    def stacks(self) -> str:
        """Return where each task is, a line for each."""
        frames, lines = sys._current_frames(), []  # noqa: SLF001 - there is no other way
        for task in self.tasks:
            if task.ended or not task.process.alive or task.ident not in frames:
                continue
            stack = traceback.extract_stack(frames[task.ident])
            places = [
                f"{each.filename.rpartition('/')[2]}:{each.lineno} {each.name}"
                for each in stack
                if "/testing/world/" not in each.filename
                and not each.filename.endswith("threading.py")
            ]
            lines.append(f"{task}: " + " > ".join(places[-4:]))
        return "\n".join(lines)


def _nothing() -> None:
    """Do nothing: after each event the scheduler looks who can run."""


class _Running:
    """What this process is to worlds.

    Attributes:
        kernel: of the world that it is; None before that has begun.
        patched: whether its standard library is that of worlds.
    """

    kernel: Kernel | None = None
    patched = False


running = _Running()


def begin(kernel: Kernel) -> None:
    """Let what is patched work for a kernel."""
    running.kernel = kernel


def here() -> Kernel:
    """Return the kernel of this world.

    Raises:
        NotSimulated: there is none yet: a module opens or waits for something while it is imported.
    """
    if running.kernel is None:
        raise NotSimulated(
            "the world has not begun: a module does I/O, or starts a thread, at import"
        )
    return running.kernel
