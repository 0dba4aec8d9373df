"""forcedimension-core, the community's binding of the whole of DHD and DRD, at the simulated library."""

from __future__ import annotations

import importlib.util
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rigs.haptic_bench import RunningSim, haptic_bench, haptic_sim, needs_compiler
from rigs.waiting import LONG, eventually

pytestmark = [
    needs_compiler,
    pytest.mark.skipif(
        importlib.util.find_spec("forcedimension_core") is None,
        reason="forcedimension-core is for Python below 3.13",
    ),
]

HAND_STIFFNESS = 2000.0
"""N/m, of the hand of plant.h."""

SPRING = """
from forcedimension_core import dhd

assert dhd.open() == 0, dhd.errorGetLastStr()
dhd.enableForce(True)
print(dhd.getSystemName(), dhd.getSDKVersion(), dhd.getDeviceID(), flush=True)
position, velocity = [0.0] * 3, [0.0] * 3
while not dhd.getButton(index=0):
    assert dhd.getPosition(out=position) == 0, dhd.errorGetLastStr()
    assert dhd.getLinearVelocity(out=velocity) == 0, dhd.errorGetLastStr()
    force = [-150.0 * place - 5.0 * speed for place, speed in zip(position, velocity)]
    assert dhd.setForce(force) == 0, dhd.errorGetLastStr()
print(*position)
dhd.close()
"""
"""The program of its README, but for the keyboard, and with forces switched on."""

OPENS = """
from forcedimension_core import dhd

print(dhd.open(), dhd.errorGetLast().name)
"""

NOT_SIMULATED = """
from forcedimension_core import dhd, drd
from forcedimension_core.dhd import expert

dhd.open()
for call in (dhd.getEffectorMass, dhd.getMaxForce, expert.preset, drd.start):
    arguments = [[0] * 8] if call is expert.preset else []
    print(call(*arguments) < 0, dhd.errorGetLast().name)
"""


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with haptic_sim(model="omega.7") as running:
        yield running


@pytest.fixture
def program(sim: RunningSim, tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Starts a program that finds the library where the vendor's SDK has it."""
    folder = tmp_path / "lib" / "release" / f"lin-{platform.machine()}-gcc"
    folder.mkdir(parents=True)
    (folder / "libdrd.so.3.16.0").symlink_to(sim.paths["library"])
    started = []

    def start(text: str) -> subprocess.Popen[str]:
        running = subprocess.Popen(
            [sys.executable, "-c", text],
            env={**os.environ, "FDSDK": str(tmp_path)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(running)
        return running

    yield start
    for running in started:
        running.kill()
        running.communicate()
    sim.control.clear()


def told(running: subprocess.Popen[str]) -> list[str]:
    """Return the lines of a program that ends well."""
    out, err = running.communicate(timeout=LONG)
    assert running.returncode == 0, err
    return out.splitlines()


def test_the_spring_of_its_readme_pulls(
    sim: RunningSim, program: Callable[[str], subprocess.Popen[str]]
) -> None:
    sim.control.inject("hold", x=0.02)
    running = program(SPRING)
    where = 0.02 * HAND_STIFFNESS / (HAND_STIFFNESS + 150.0)  # hand and spring hold each other
    eventually(
        lambda: (
            sim.control.status()["force"] == pytest.approx([-150.0 * where, 0.0, 0.0], abs=0.01)
        ),
        "it stands between both",
    )
    sim.control.inject("press", button=0)
    name, place = told(running)
    assert name.startswith("omega.7 ")
    assert name.endswith(" 0")
    # What it pulled with tells where it read the hand to be; held up since then, it may have let go.
    let_go = 0.02 - where + 1e-4
    assert [float(each) for each in place.split()] == pytest.approx([where, 0.0, 0.0], abs=let_go)
    assert not sim.control.status()["forces_on"], "it closes the device"


def test_it_and_the_driver_do_not_have_the_device_at_once(
    sim: RunningSim, program: Callable[[str], subprocess.Popen[str]]
) -> None:
    with haptic_bench(sim, model="omega.7"):
        assert told(program(OPENS)) == ["-1 DEVICE_IN_USE"]


def test_what_is_not_simulated_fails_and_says_so(
    program: Callable[[str], subprocess.Popen[str]],
) -> None:
    assert told(program(NOT_SIMULATED)) == ["True NOT_AVAILABLE"] * 4
