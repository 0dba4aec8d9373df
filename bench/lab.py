"""How long it takes until a lab measures, until a dead device is noticed, and until it is back.

    python -m bench.lab --trials 10

Two loopback devices, as under ``crtk-driver up``; one of them is killed again and again.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench.report import show, spread
from crtk_drivers.labs import load_lab, supervisor
from crtk_drivers.labs.child import FIRST_DELAY, Phase
from crtk_drivers.labs.supervisor import Supervisor

LAB = '[devices.one]\nplugin = "loopback"\n[devices.two]\nplugin = "loopback"\n'
PATIENCE = 60.0


def until(lab: Supervisor, test: Callable[[], object]) -> float:
    """Step until `test` holds; return how long that took, s."""
    began = time.monotonic()
    while not test():
        if time.monotonic() > began + PATIENCE:
            raise TimeoutError("it never came")
        lab.step()
        time.sleep(supervisor.LOOK_PERIOD)
    return time.monotonic() - began


def measure(trials: int) -> list[tuple[str, list[float]]]:
    """Return what is measured, and the seconds of each trial."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lab.toml"
        path.write_text(LAB)
        lab = Supervisor(load_lab(path), Path(folder))
        started = [until(lab, lambda: all(child.is_ready for child in lab.children))]
        one = lab.devices["one"]
        noticed, back = [], []
        for _ in range(trials):
            one.delay = FIRST_DELAY
            assert one.process is not None
            os.kill(one.process.pid, signal.SIGKILL)
            noticed.append(until(lab, lambda: one.phase is Phase.RESTARTING))
            back.append(noticed[-1] + until(lab, lambda: one.is_ready))
        began = time.monotonic()
        lab.stop()
        stopped = [time.monotonic() - began]
    return [
        ("both devices measure after", started),
        ("a dead device is noticed after", noticed),
        ("and measures again after (the delay of 1 s included)", back),
        ("both have stopped after", stopped),
    ]


def main() -> None:
    """Measure, and print it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=10)
    logging.disable(logging.CRITICAL)
    rows = [[text, *spread(found, 1.0, 2)] for text, found in measure(parser.parse_args().trials)]
    show("a lab of two devices, s", ("", "p50", "p99", "max"), rows)


if __name__ == "__main__":
    main()
