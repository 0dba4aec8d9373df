"""The promises of every driver at fixed seeds, at seeds that once failed, and at a new one each time.

What a failure prints ends with the command that runs it again. `python -m bench.world` searches for hours.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final

import pytest

from bench.reliability.worlds import DEVICES, SCENARIOS, Case, Runner, shrunk, story

FIXED: Final = {
    "use": ((1, True), (2, True), (3, False)),
    "farewell": ((1, True), (2, True), (3, True)),
    "die": ((1, True), (2, False)),
    "still": ((1, True),),
    "far": ((1, True), (2, True), (3, False)),
    "watch": ((1, True), (2, True), (3, False)),
    "push": ((1, True), (2, True), (3, False)),
    "tread": ((1, True), (2, False)),
}
"""Of each device: seeds, and whether the world is wild."""

KEPT: Final[dict[Case, str]] = {
    Case("ur", "farewell", 50003): (
        "A thread that stood still outlived close by 0.6 s, and the judge did not wait for it."
    ),
    Case("ur", "far", 22): (
        "A client took a move for reached that another one had stopped: the newest setpoint was not valid."
    ),
    Case("weiss-wsg", "use", 1796144768): (
        "A sample was too old while close waited for a gripper that stood still."
    ),
    Case("weiss-wsg", "far", 1796144751): (
        "A thread was held up between the beginning of a stop, for the judge, and for the driver."
    ),
    Case("copley", "use", 1796144608): (
        "A stream began far from where its drives stood: they leapt there at 1.7 times their limit."
    ),
    Case("onrobot", "use", 1796078373): (
        "A simulator made up for 22 ms at once and arrived; it was judged by where it was before."
    ),
    Case("weiss-wsg", "use", 1796089130): (
        "Another client moved on what had reached its goal, before the first one looked where it was."
    ),
    Case("ndi", "watch", 1796089132): (
        "A question that was held back before the tracker's clock was known made a stamp early."
    ),
    Case("ndi", "watch", 1796093968113): (
        "A frame from before a tool was shown again was compared with where that was afterwards."
    ),
    Case("robotiq-ft300", "watch", 1796145226783): (
        "A load that changed while a bias was measured, and while it was checked, counted as noise."
    ),
    Case("robotiq-ft300", "watch", 1796144244602): (
        "A thread was held up for less than the driver can tell from a sensor that stood still."
    ),
    Case("robotiq-ft300", "watch", 1796089736): (
        "A thread was held up between the two clocks of a stamp."
    ),
    Case("optoforce", "watch", 1796089125): (
        "A load and the zero of the unit changed between two looks of the judge."
    ),
    Case("schunk-fts", "watch", 1796089125): "Two loads changed between two looks of the judge.",
    Case("ati-netft", "watch", 1796116054784): (
        "The wall clock was set while datagrams waited; they were stamped with when they were read."
    ),
    Case("ati-netft", "watch", 1796124355751): (
        "Two biases were set between two looks of the judge, which knew of the second only."
    ),
}
"""Every case that ever failed, and what was wrong."""


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as made:
        yield made


def judged(runner: Runner, case: Case) -> None:
    """Run a case; what it finds fails, as the story of the fewest troubles that it needs."""
    outcome = runner.run(case)
    if outcome.findings:
        pytest.fail(story(case, shrunk(runner, case, outcome)), pytrace=False)


def test_every_scenario_has_fixed_seeds() -> None:
    assert set(FIXED) == set(SCENARIOS)


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("device", "scenario", "seed", "wild"),
    [
        (device, name, *each)
        for name, some in FIXED.items()
        for each in some
        for device in SCENARIOS[name]
    ],
)
def test_fixed_seeds_find_nothing(
    runner: Runner, device: str, scenario: str, seed: int, wild: bool
) -> None:
    judged(runner, Case(device, scenario, seed, wild))


@pytest.mark.parametrize("device", DEVICES)
def test_new_seed_finds_nothing(runner: Runner, device: str) -> None:
    """Of a scenario by chance. Searches try thousands."""
    seed = time.time_ns() // 1_000_000
    known = [name for name, devices in SCENARIOS.items() if device in devices]
    judged(runner, Case(device, known[seed % len(known)], seed))


@pytest.mark.parametrize(
    "case", [case for case in KEPT if case.device in SCENARIOS[case.scenario]], ids=str
)
def test_kept_seeds_find_nothing(runner: Runner, case: Case) -> None:
    judged(runner, case)
