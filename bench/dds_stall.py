"""Trouble in DDS and the I/O loop beside it: a stalled and a killed subscriber, and a writer that blocks.

The driver publishes six topics at 500 Hz to two subscribers, in phases one after the other: quiet; one
subscriber stopped (SIGSTOP); the same one killed (SIGKILL), which DDS notices only after 20 s; and a DDS
writer that holds each 500th message for a third of a second, inside the middleware, as Fast DDS does when a
shared-memory port looks unhealthy (its issue 6535). The last needs a C compiler: the delay is put between rcl
and the middleware by a library that is preloaded into the driver, and takes effect when a file exists.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from bench import processes
from bench.recording import load
from bench.report import options, show, spread

LATE = 0.004
HOLD = 1.0 / 3.0
EVERY = 500

_HOLDING_WRITER = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <unistd.h>

typedef int (*Publish)(const void *, const void *, void *);

static Publish real(const char *name)
{
  void *middleware = dlopen("librmw_implementation.so", RTLD_NOLOAD | RTLD_LAZY);
  if (!middleware) middleware = dlopen("librmw_fastrtps_cpp.so", RTLD_NOLOAD | RTLD_LAZY);
  return (Publish) dlsym(middleware, name);
}

static void hold(void)
{
  static int count;
  if (++count % EVERY == 0 && access(SWITCH, F_OK) == 0) usleep(HOLD);
}

int rmw_publish(const void *publisher, const void *message, void *allocation)
{
  hold();
  return real("rmw_publish")(publisher, message, allocation);
}

int rmw_publish_serialized_message(const void *publisher, const void *message, void *allocation)
{
  hold();
  return real("rmw_publish_serialized_message")(publisher, message, allocation);
}
"""


def build_holding_writer(folder: Path, switch: Path) -> Path | None:
    """Compile the preloaded library; None if there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    library = folder / "holding_writer.so"
    values = (f"-DEVERY={EVERY}", f'-DSWITCH="{switch}"', f"-DHOLD={round(HOLD * 1e6)}")
    command = [compiler, "-shared", "-fPIC", "-x", "c", *values, "-o", str(library), "-", "-ldl"]
    subprocess.run(command, input=_HOLDING_WRITER, text=True, check=True)
    return library


def longest_gap(times: np.ndarray) -> float:
    """Return the longest time between two messages, in ms."""
    return float(np.diff(times).max()) / 1e6 if len(times) > 1 else float("nan")


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(15.0, "of each phase"))
    phases: list[tuple[str, float, float]] = []

    def phase(name: str) -> None:
        begin = time.time_ns()
        monotonic = time.monotonic()
        time.sleep(given.seconds)
        phases.append((name, monotonic, begin))

    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        switch = records / "hold"
        library = build_holding_writer(records, switch)
        preload = {"LD_PRELOAD": str(library)} if library else {}
        with (
            processes.simulator(records) as sim,
            processes.driver(sim, records, environment=preload),
            processes.client(records, "--enable", "--name", "listener") as listener,
            processes.client(records, "--name", "victim") as victim,
        ):
            processes.wait_ready(listener)
            processes.wait_ready(victim)
            phase("quiet")
            victim.send_signal(signal.SIGSTOP)
            phase("subscriber stopped")
            victim.kill()
            victim.wait()
            phase("subscriber killed")
            if library:
                switch.touch()
                phase("writer blocks")
        cycles, heard = load(records, "cycles")[:, 0], load(records, "listener_heard")
    rows = []
    for name, begin, wall in phases:
        periods = np.diff(cycles[(cycles >= begin) & (cycles <= begin + given.seconds)])
        during = (heard[:, 2] >= wall) & (heard[:, 2] <= wall + 1e9 * given.seconds)
        called = heard[during & (heard[:, 0] == 0), 2]
        rows.append(
            [
                name,
                f"{1.0 / periods.mean():.2f}",
                f"{100.0 * np.mean(periods > LATE):.3f}",
                *spread(periods, 1e3, 2),
                f"{len(called) / given.seconds:.0f}",
                f"{longest_gap(called):.0f}",
            ]
        )
    notes = [
        "left: cycles of the I/O loop (late: over 4 ms); right: measured_js at the healthy subscriber.",
        f"A blocked writer holds one message in {EVERY} for {1e3 * HOLD:.0f} ms.",
    ]
    if not library:
        notes.append(
            "There is no C compiler (cc) here: the phase with a blocked writer is left out."
        )
    show(
        f"I/O loop while DDS is in trouble, {given.seconds:g} s each",
        ("phase", "Hz", "late %", "p50 ms", "p99 ms", "max ms", "heard Hz", "longest gap ms"),
        rows,
        notes,
    )


if __name__ == "__main__":
    main()
