"""Give all processes of a session the priority that a process has by default.

    python3 .ci/hurry.py SESSION

SESSION is the id of the process that leads it. `steps.sh` runs some scripts at idle priority, and calls this
once it waits for one: beside processes that compute, the script might get no time at all. Only root may raise
a priority.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

GONE = (ProcessLookupError, FileNotFoundError)
"""What a look at a process raises once it has ended."""


def threads(session: int) -> Iterator[int]:
    """Yield the threads of all processes of a session: each has a priority of its own."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(*GONE):
            if os.getsid(int(process.name)) == session:
                yield from map(int, os.listdir(process / "task"))


def hurry(session: int) -> None:
    """Give all threads of a session the default priority.

    A process that begins meanwhile may inherit the low one, so it looks again until no thread is new.

    Raises:
        PermissionError: this user may not raise a priority.
    """
    hurried: set[int] = set()
    while slow := set(threads(session)) - hurried:
        for thread in slow:
            with suppress(*GONE):
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, thread, 0)
        hurried |= slow


def give_default_share(session: int) -> None:
    """Give a session the default share of the processor, where each has one (sched_autogroup).

    Linux refuses a second change within a tenth of a second, whichever the session.
    """
    for _ in range(50):
        try:
            Path(f"/proc/{session}/autogroup").write_text("0")
        except BlockingIOError:
            time.sleep(0.1)
        except OSError:  # no autogroups here, or the session has ended
            return
        else:
            return


give_default_share(int(sys.argv[1]))
try:
    hurry(int(sys.argv[1]))
except PermissionError:
    print("what runs beside goes on at its low priority: only root may raise it")
