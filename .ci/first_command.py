"""Do what the README says under "Start", word for word, in an environment without `ros2`.

Its first command runs a simulated arm; the commands for another terminal follow one after the other, and each
must end with exit code 0. Ctrl-C then ends the first with exit code 0. Run in the root of the repository.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

BLOCK = re.compile(r"^```sh\n(?P<commands>.*?)^```$", re.MULTILINE | re.DOTALL)
INSTALL = "pip install uv && "  # whoever runs this has uv


def commands() -> tuple[list[str], list[list[str]]]:
    """Return the first command, and those for another terminal."""
    start = Path("README.md").read_text().partition("## Start")[2].partition("\n## ")[0]
    first, _tests, others = (block["commands"] for block in BLOCK.finditer(start))
    assert first.startswith(INSTALL), first
    return shlex.split(first.removeprefix(INSTALL)), list(map(shlex.split, others.splitlines()))


def wait_for_device(process: "subprocess.Popen[bytes]", look: list[str], timeout: float) -> None:
    """Wait until `look` finds the device of `process`: a reader would see that it is there."""
    deadline = time.monotonic() + timeout
    while subprocess.run(look, capture_output=True).returncode != 0:
        if process.poll() is not None:
            sys.exit(f"{process.args} ended by itself, exit code {process.returncode}")
        if time.monotonic() > deadline:
            sys.exit(f"{look} found no device within {timeout:.0f} s")


def main() -> None:
    """Start the first command, follow the others, interrupt it."""
    if shutil.which("ros2"):
        sys.exit("ros2 is installed here: this is for an environment without it")
    begin = time.monotonic()
    first, others = commands()
    # A session of its own, so that nothing of it outlives a failure.
    process = subprocess.Popen(first, start_new_session=True)
    try:
        wait_for_device(process, others[0], timeout=60)
        print(f"the device is there after {time.monotonic() - begin:.1f} s", flush=True)
        for command in others:
            print(f"$ {shlex.join(command)}", flush=True)
            subprocess.run(command, check=True, timeout=40)
        # To uv alone, which passes it on: the driver gets one, as it does at a terminal.
        process.send_signal(signal.SIGINT)
        code = process.wait(timeout=10)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code != 0:
        sys.exit(f"{first} answered Ctrl-C with exit code {code}")


main()
