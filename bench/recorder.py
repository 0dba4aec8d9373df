"""Recording: what it costs a driver, what the black box costs, what is lost, also by kill -9.

A virtual arm at 500 Hz, in plain Python, ENABLED: 6 topics of each sample. CPU is that of the whole process
in percent of a core; lateness is the error of the period between two samples. The bytes that were recorded
are written again, by our writer (flushed each 30 ms) and by the `mcap` library, from memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

import crtk_drivers
from bench.report import options, show, show_calls
from crtk_drivers.motion.past import Moment
from crtk_drivers.recording import McapWriter, Message, Recording, mend

WAYS = ("bare", "black box", "recorded")
FLUSHED = 90
"""Messages that come in 30 ms."""


def started(way: str, seconds: float, folder: Path) -> subprocess.Popen[str]:
    """Start a driver; its word for a way is one."""
    command = [sys.executable, "-m", "bench.recorded_arm_cost", way.replace(" ", "_")]
    return subprocess.Popen(
        [*command, str(seconds), str(folder)], stdout=subprocess.PIPE, text=True
    )


def found(child: subprocess.Popen[str]) -> dict[str, Any]:
    """Return what a driver printed."""
    out, _ = child.communicate()
    answer: dict[str, Any] = json.loads(out.splitlines()[-1])
    return answer


def alone(turns: int, seconds: float, folder: Path) -> None:
    """Compare the three ways, one driver at a time, in turns."""
    answers: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for _ in range(turns):
        for way in WAYS:
            answers[way].append(found(started(way, seconds, folder)))
    bare = statistics.median(each["cpu"] for each in answers["bare"])
    rows = []
    for way, of in answers.items():
        cpu = statistics.median(each["cpu"] for each in of)
        late = [statistics.median(each["late"][i] for each in of) for i in range(3)]
        rate = statistics.median(each["samples"] for each in of)
        more = f"{100 * (cpu - bare):+.1f}"
        rows.append(
            [way, f"{100 * cpu:.1f}", more, f"{rate:.0f}", *(f"{1e6 * v:.0f}" for v in late)]
        )
    columns = ("driver", "CPU %", "more", "samples/s", "late p50 us", "p99", "max")
    show("A driver at 500 Hz", columns, rows, [f"Medians of {turns} turns of {seconds:g} s."])


def a_cycle(folder: Path) -> None:
    """Time what the I/O thread does for the black box at the end of a cycle."""
    with crtk_drivers.connect("virtual", rate=500.0, recording={"folder": str(folder)}) as arm:
        engine, moments = arm.engine, list[Moment]()
        keep, engine.keepers = engine.keepers, (*engine.keepers, moments.append)
        engine.wait_for(lambda: moments, 5.0)
        engine.keepers = ()
        moment = moments[-1]
        show_calls(
            "The black box", {"kept, a cycle": lambda: [each(moment) for each in keep]}, 5000
        )


def many(counts: list[int], seconds: float, folder: Path) -> Path:
    """Record several drivers beside each other, a process each; return a file."""
    rows, path = [], Path()
    for count in counts:
        children = [started("recorded", seconds, folder) for _ in range(count)]
        answers = [found(child) for child in children]
        path = folder / f"{children[0].pid}.mcap"
        cpu = [each["cpu"] for each in answers]
        rows.append(
            [
                str(count),
                f"{sum(each['samples'] for each in answers) / count:.0f}",
                str(sum(each["written"] for each in answers)),
                str(sum(each["lost"] for each in answers)),
                f"{sum(each['size'] for each in answers) / 1e6:.1f}",
                f"{100 * statistics.mean(cpu):.1f}",
                f"{1e6 * max(each['late'][1] for each in answers):.0f}",
            ]
        )
    columns = ("devices", "samples/s of 500", "written", "lost", "MB", "CPU % each", "late p99 us")
    show("Devices that record 6 topics at 500 Hz, a process each", columns, rows)
    return path


def per_message(write: Callable[[list[Message]], None], messages: list[Message]) -> float:
    """Return the CPU time (s) of a message."""
    took = []
    for _ in range(5):
        began = time.process_time()
        write(messages)
        took.append(time.process_time() - began)
    return statistics.median(took) / len(messages)


def by_ours(messages: list[Message]) -> None:
    """Write by our writer."""
    with tempfile.TemporaryDirectory() as name, McapWriter(Path(name, "a.mcap")) as writer:
        for number, each in enumerate(messages):
            channel = writer.channel(each.topic, each.type_name)
            writer.message(channel, each.data, each.log_time, each.publish_time)
            if number % FLUSHED == 0:
                writer.flush()


def by_library(compression: CompressionType, chunk_size: int) -> Callable[[list[Message]], None]:
    """Return what writes by the `mcap` library."""

    def write(messages: list[Message]) -> None:
        writer = Writer(BytesIO(), chunk_size=chunk_size, compression=compression)
        writer.start("ros2", "bench")
        channels = {}
        for each in messages:
            if each.topic not in channels:
                schema = writer.register_schema(each.type_name, "ros2msg", b"")
                channels[each.topic] = writer.register_channel(each.topic, "cdr", schema)
            writer.add_message(
                channels[each.topic], each.log_time, each.data, each.publish_time, each.sequence
            )
        writer.finish()

    return write


def same_bytes(path: Path) -> None:
    """Write what was recorded again."""
    messages = list(Recording(path).messages())
    ways = {
        "our writer, flushed each 30 ms": by_ours,
        "mcap, not compressed, 1 MB": by_library(CompressionType.NONE, 1 << 20),
        "mcap, zstd, 1 MB (its default)": by_library(CompressionType.ZSTD, 1 << 20),
    }
    rows = []
    for name, write in ways.items():
        each = per_message(write, messages)
        rows.append([name, f"{1e6 * each:.2f}", f"{100 * each * 3000:.1f}"])
    columns = ("writer", "us a message", "% of a core at 3000 a second")
    show(f"{len(messages)} messages of a recording, written again", columns, rows)


def killed(times: int, folder: Path) -> None:
    """Kill a driver that records, and see what is lost: from its last sample to the kill."""
    lost = []
    for _ in range(times):
        child = started("recorded", 60.0, folder)
        path = folder / f"{child.pid}.mcap"
        while not path.exists() or path.stat().st_size < 300_000:
            time.sleep(0.01)
        at = time.time_ns()
        child.send_signal(signal.SIGKILL)
        child.communicate()
        mend(path)
        newest = max(message.log_time for message in Recording(path).messages())
        lost.append((at - newest) * 1e-6)
    told = ", ".join(f"{each:.0f}" for each in sorted(lost))
    show("Lost by kill -9", ("ms of data",), [[told]], ["The files were mended and read."])


@contextlib.contextmanager
def folder_of_bench() -> Iterator[Path]:
    """A folder on the disk of the working directory."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as name:
        yield Path(name)


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        seconds=(5.0, "of each turn"),
        turns=(5, "of each way"),
        devices=(4, "at most, beside each other"),
        kills=(6, "of a driver that records"),
    )
    with folder_of_bench() as folder:
        a_cycle(folder)
        alone(given.turns, given.seconds, folder)
        counts = [count for count in (1, 2, 4, 8, 16) if count <= given.devices]
        same_bytes(many(counts, given.seconds, folder))
        killed(given.kills, folder)


if __name__ == "__main__":
    main()
