"""Do what the program prints, word for word: python3 .ci/printed_commands.py PROGRAM...

PROGRAM is how `crtk-driver` is started: ``./crtk-driver``, ``uv run crtk-driver``, ``venv/bin/crtk-driver``.
It carries out the steps of `crtk-driver new`, the commands of the hint of a driver that runs, and the command
that brings a missing extra. A plugin is installed, which whoever runs this takes away.
"""

import shlex
import signal
import subprocess
import sys
import tempfile
from threading import Timer

from first_command import running

NAME = "printed_scale"
LONG = 300
"""Seconds that a command may take: one downloads."""


def output(command: str) -> str:
    """Run a command and return its standard output. One that shows values gets Ctrl-C after the first."""
    print(f"$ {command}", flush=True)
    process = subprocess.Popen(shlex.split(command), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    end = Timer(LONG, process.kill)
    end.start()
    text = process.stdout.readline()
    if " echo " in command:
        process.send_signal(signal.SIGINT)
    text += process.stdout.read()
    code = process.wait()
    end.cancel()
    if code:
        sys.exit(f"{command}: exit code {code}\n{text}")
    return text


def start_a_plugin(program: str) -> None:
    """Write a plugin, and do what is printed: to the driver that runs, and to what its hint names."""
    with tempfile.TemporaryDirectory() as folder:
        told = output(f"{program} new sensor {NAME} -C {folder}")
        print(told, flush=True)
        *steps, last = [line.strip() for line in told.splitlines() if line.startswith("  ")]
        for step in steps:
            output(step)
        with running(last) as hint:
            for step in hint:
                assert output(step)


def bring_an_extra(program: str) -> None:
    """Ask for what needs an extra; where that is missing, do what is printed and ask again."""
    command = f"{program} moveit virtual"
    print(f"$ {command}", flush=True)
    done = subprocess.run(shlex.split(command), capture_output=True, text=True, timeout=LONG)
    if done.returncode:
        print(done.stderr, flush=True)
        output(done.stderr.partition("Install it with: ")[2].strip())
        output(command)


if __name__ == "__main__":
    # A shell starts what runs in the background with SIGINT ignored, and all of its children, too.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    start_a_plugin(shlex.join(sys.argv[1:]))
    bring_an_extra(shlex.join(sys.argv[1:]))
