"""Sessions of the unmodified ur_rtde library, each in its own process, and what is asked of them."""

import subprocess
import sys

from rigs.ur_clients import last_json


def run_session(script, sim, name, timeout):
    """Run the session `name` of `script` with a simulated controller and return its results."""
    result = subprocess.run(
        [sys.executable, script, name, sim.host, str(sim.ports["control"])],
        stdout=subprocess.PIPE,
        text=True,
        timeout=timeout,
        check=True,
    )
    return last_json(result.stdout)


def assert_all(result, **within):
    """Every value is true, but those named, which lie below their limits."""
    for name, limit in within.items():
        assert result.pop(name) < limit, name
    assert {name: value for name, value in result.items() if not value} == {}
