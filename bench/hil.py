"""What the hardware-in-the-loop bench costs, and how well its figures repeat.

    python -m bench.hil --runs 5 --device virtual

Runs the quick suite again and again; prints how long it takes, what of a core each process of it takes, and
median and spread (median absolute deviation) of every figure: that decides what "worse" means.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.results import Run
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.verdicts.judging import number
from crtk_drivers.status.stop_request import StopRequest

LOOK = 0.5
TICK = float(os.sysconf("SC_CLK_TCK"))


def cpu_of(pid: int) -> tuple[str, float] | None:
    """Return what a process of the bench is, and the CPU seconds that it has taken; None for any other."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    seconds = (int(fields[11]) + int(fields[12])) / TICK
    if "labs.bench.host" in command:
        return "driver, with its recorder", seconds
    if "labs.bench.conductor" in command:
        return "conductor", seconds
    return None


class Usage(threading.Thread):
    """Looks at the processes of the bench until `stop`; `seconds` by kind and process."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.seconds: dict[tuple[str, int], float] = {}
        self._ended = threading.Event()

    def run(self) -> None:
        """Look."""
        while not self._ended.wait(LOOK):
            for entry in Path("/proc").iterdir():
                found = cpu_of(int(entry.name)) if entry.name.isdigit() else None
                if found is not None:
                    self.seconds[found[0], int(entry.name)] = found[1]

    def stop(self) -> dict[str, float]:
        """End, and return the CPU seconds of each kind."""
        self._ended.set()
        self.join()
        kinds: dict[str, float] = defaultdict(float)
        for (kind, _), seconds in self.seconds.items():
            kinds[kind] += seconds
        return dict(kinds)


def quick(device: str, folder: Path, name: str) -> tuple[Run, float]:
    """Run the quick suite of one device; return what was found, and the judge's own CPU seconds."""
    path = folder / "lab.toml"
    path.write_text(f'[devices.one]\nplugin = "{device}"\n')
    lab = load_lab(path, sim=True)
    before = time.process_time()
    options = BenchOptions(Suite.QUICK, (), may_move=False, out=folder / name)
    run = run_bench(lab, options, lambda *_: None, StopRequest())
    return run, time.process_time() - before


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--device", default="virtual")
    given = parser.parse_args()
    values: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    verdicts: dict[str, int] = defaultdict(int)
    seconds, costs = [], []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(given.runs):
            usage = Usage()
            usage.start()
            run, judging = quick(given.device, Path(folder), f"run-{index}")
            costs.append({**usage.stop(), "judge": judging})
            seconds.append(run.seconds)
            for _, test in run.tests:
                verdicts[test.verdict] += 1
                for found in test.measurements:
                    if found.value is not None:
                        values[found.id, found.part, found.unit].append(found.value)
    load = os.getloadavg()[0]
    print(f"{given.device}, {given.runs} runs of the quick suite, load at the end {load:.1f}")
    print(
        f"  time: median {statistics.median(seconds):.1f} s, {min(seconds):.1f} to {max(seconds):.1f}"
    )
    print(f"  verdicts: {json.dumps(verdicts)}")
    for kind in costs[0]:
        shares = [cost.get(kind, 0.0) / time_ for cost, time_ in zip(costs, seconds, strict=True)]
        print(f"  {kind}: {100.0 * statistics.median(shares):.1f} % of a core")
    print(f"{'figure':44s} {'part':10s} {'n':>3s} {'median':>10s} {'spread':>10s}")
    for (name, part, unit), found in values.items():
        usual = statistics.median(found)
        spread = statistics.median(abs(value - usual) for value in found)
        print(
            f"{name:44s} {part:10s} {len(found):3d} {number(usual):>10s} {number(spread):>10s} {unit}"
        )


if __name__ == "__main__":
    main()
