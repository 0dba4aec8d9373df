"""Do what the README says under "Start", word for word, on a machine without `ros2`.

Its first command runs a simulated arm, which prints commands to go on with. Those follow in another process,
and then the README's own: each must end with exit code 0. Ctrl-C ends the first command with exit code 0. Run
in the root of the repository, by any Python.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import IO

BLOCK = re.compile(r"^```sh\n(?P<commands>.*?)^```$", re.MULTILINE | re.DOTALL)
HINT = "in another terminal:"
STEP = "  "
"""Before each command of the hint, a line each."""
SET_UP = 600
"""Seconds that the first command may take to set up all that it needs, and to run."""


def commands() -> tuple[str, list[str]]:
    """Return the first command, and those for another terminal."""
    start = Path("README.md").read_text().partition("## Start")[2].partition("\n## ")[0]
    first, _tests, others = (block["commands"] for block in BLOCK.finditer(start))
    return first.strip(), others.splitlines()


class Relay(Thread):
    """Shows what a process writes, and keeps the commands of its hint."""

    def __init__(self, lines: IO[str]) -> None:
        super().__init__(daemon=True)
        self._lines = lines
        self.hint: list[str] = []
        self.met = Event()

    def run(self) -> None:  # no `override`: any Python runs this
        """Read to the end."""
        in_hint = False
        for line in self._lines:
            print(line, end="", file=sys.stderr, flush=True)
            if in_hint and line.startswith(STEP):
                self.hint.append(line.strip())
                continue
            if in_hint:
                self.met.set()
            in_hint = HINT in line
        self.met.set()


@contextmanager
def running(command: str) -> Iterator[list[str]]:
    """Run a device, for a block that gets the commands which it prints to go on with. Ctrl-C ends it well."""
    begin = time.monotonic()
    print(f"$ {command}", flush=True)
    # A session of its own, so that nothing of it outlives a failure.
    process = subprocess.Popen(
        shlex.split(command), start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    relay = Relay(process.stderr)
    relay.start()
    try:
        relay.met.wait(SET_UP)
        if not relay.hint:
            sys.exit(f"{command}: printed no {HINT!r} in {time.monotonic() - begin:.0f} s")
        print(f"the device is there after {time.monotonic() - begin:.1f} s", flush=True)
        yield relay.hint
        # To one process alone, which passes it on: the driver gets one, as it does at a terminal.
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=10)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code != 0:
        sys.exit(f"{command} answered Ctrl-C with exit code {code}")


def main() -> None:
    """Start the first command, follow the others, interrupt it."""
    if shutil.which("ros2"):
        sys.exit("ros2 is installed here: this is for an environment without it")
    first, others = commands()
    with running(first) as hint:
        for command in (*hint, *others):
            print(f"$ {command}", flush=True)
            done = subprocess.run(shlex.split(command), timeout=40)
            if done.returncode:
                sys.exit(f"{command}: exit code {done.returncode}")


if __name__ == "__main__":
    main()
