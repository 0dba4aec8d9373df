"""S7: an emergency stop, pressed on a simulator, or by somebody who is asked to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Subject, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, lacking, unguarded
from crtk_drivers.labs.bench.bed import Bed, Broken
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.conducting import Asked
from crtk_drivers.labs.bench.operator import PERSON_RELEASES, PERSON_TAKES, Person
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.loopback import ROTARY
from rigs import stepped_bed

S7 = next(test for test in TESTS if test.id == "S7")

ARM = '[devices.{0}]\nplugin = "ur"\nsim = true\nsim_options = {{ {1} }}\n'


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_button_that_does_nothing_is_found(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        ARM.format("sound", "") + ARM.format("deaf", 'defects = "ignores_emergency_stop=1"')
    )
    options = BenchOptions(Suite.QUICK, ("S7",), False, tmp_path / "run", at_once=2)
    run = run_bench(load_lab(path), options, lambda *_: None, StopRequest())
    found = {device.name: test for device, test in run.tests}
    assert found["sound"].verdict is not Verdict.FAIL, found["sound"]
    assert {one.id for one in found["sound"].measurements} == {one.id for one in S7.quantities}
    assert found["deaf"].verdict is Verdict.FAIL
    assert "ENABLED while the button is pressed" in found["deaf"].reason


SOUND = {
    "noticed": 0.02,
    "look": 0.004,
    "by_operator": False,
    "before": [0.5],
    "pressed": [0.501],
    "pressed_state": "FAULT",
    "released": [0.501],
    "released_state": "FAULT",
    "enabled_again": True,
}


@pytest.mark.parametrize(
    ("kept", "failing"),
    [
        ({}, set()),
        ({"noticed": 0.5}, {"stop.emergency.time"}),
        ({"noticed": 20.0, "by_operator": True}, set()),
        ({"pressed": [0.52], "released": [0.52]}, {"stop.emergency.distance"}),
        ({"released": [0.52]}, {"stop.emergency.after"}),
    ],
    ids=["sound", "late", "by_a_person", "falls", "jumps"],
)
def test_what_an_emergency_stop_did_is_judged(kept: dict[str, Any], failing: set[str]) -> None:
    subject = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
    found = S7.analyse(Trace.of([]), replace(subject, kept=SOUND | kept))
    beyond = {one.quantity.id for one in found.measurements if one.verdict is Verdict.FAIL}
    assert beyond == failing
    assert found.verdict is (Verdict.FAIL if failing else Verdict.PASS)


@pytest.mark.parametrize(
    ("state", "told"),
    [
        ("pressed_state", "while the button is pressed"),
        ("released_state", "after the button was released"),
    ],
)
def test_a_device_that_is_enabled_meanwhile_fails(state: str, told: str) -> None:
    subject = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
    found = S7.analyse(Trace.of([]), replace(subject, kept=SOUND | {state: "ENABLED"}))
    assert found.verdict is Verdict.FAIL
    assert len(found.violations) == 1
    assert told in found.violations[0]


def test_a_simulator_that_notices_it_long_after_fails() -> None:
    subject = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
    found = S7.analyse(Trace.of([]), replace(subject, kept=SOUND | {"noticed": None}))
    assert found.verdict is Verdict.FAIL
    assert "still ENABLED" in found.reason


@pytest.mark.parametrize(
    ("kept", "verdict"), [({}, Verdict.INCONCLUSIVE), ({"pressed": [0.6]}, Verdict.FAIL)]
)
def test_one_that_was_not_enabled_again_does_not_pass(
    kept: dict[str, Any], verdict: Verdict
) -> None:
    """As with a button that is pulled out too late, after which the acquisition breaks off."""
    subject = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
    until_then = {name: value for name, value in SOUND.items() if name != "enabled_again"}
    assert S7.analyse(Trace.of([]), replace(subject, kept=until_then | kept)).verdict is verdict


SLOW = {"rate": 100.0}
"""Of a virtual arm: what an emergency stop does takes seconds, and each cycle is computed."""


class Bystander:
    """Somebody beside a virtual arm, who does `press` when asked for its emergency stop: it has none."""

    is_person = True

    def __init__(self, press: Callable[[Bed], object]) -> None:
        self._press = press
        self.bed: Bed | None = None
        self.released = 0

    def press_stop(self) -> None:
        assert self.bed is not None
        self._press(self.bed)

    def release_stop(self) -> None:
        self.released += 1


def kept_beside(operator: Bystander) -> dict[str, Any]:
    """Return what S7 keeps of a virtual arm."""

    def run(bed: Bed) -> None:
        operator.bed = bed
        S7.acquisition.run(bed)

    acquisition = replace(S7.acquisition, run=run)
    _, subject = stepped_bed.acquired(acquisition, "virtual", SLOW, operator=operator)
    return dict(subject.kept)


def test_a_person_is_waited_for() -> None:
    operator = Bystander(lambda bed: bed.command_state("disable"))
    kept = kept_beside(operator)
    assert kept["by_operator"]
    assert (kept["pressed_state"], kept["released_state"]) == ("DISABLED", "DISABLED")
    assert kept["enabled_again"]
    assert operator.released == 1


@pytest.mark.slow
def test_a_person_who_does_not_press_is_not_waited_for_for_ever() -> None:
    operator = Bystander(lambda bed: None)
    with pytest.raises(Broken, match="not pressed within 60 s"):
        kept_beside(operator)
    assert operator.released == 1


def test_a_person_is_told_what_to_do_and_how_soon() -> None:
    told: list[object] = []
    person = Person(told.append, "arm")
    person.press_stop()
    person.release_stop()
    assert told == [
        Asked(f"press the emergency stop of arm, within {PERSON_TAKES:g} s"),
        Asked(f"release the emergency stop of arm, within {PERSON_RELEASES:g} s"),
    ]


def test_it_is_pressed_where_somebody_is_there_for_that(tmp_path: Path) -> None:
    about = stepped_bed.about("virtual", {})

    def why(device: str, head: str = "", *, may_move: bool = True) -> str:
        path = tmp_path / "lab.toml"
        path.write_text(f"{head}[devices.arm]\n{device}\n")
        lab = load_lab(path)
        options = BenchOptions(Suite.FULL, (), may_move, tmp_path)
        return lacking(S7, about, lab.devices["arm"], options, features=lab.settings.features)

    def guards(device: str) -> str:
        path = tmp_path / "lab.toml"
        path.write_text(f"[devices.arm]\n{device}\n")
        return unguarded(S7, load_lab(path).devices["arm"], ["S7"])

    real = 'plugin = "ur"\nsettings = { host = "192.168.1.9" }'
    assert "operator = true" in why(real)
    there = "features = { operator = true }\n"
    assert why(real, there) == ""
    assert "--may-move" in why(real, there, may_move=False)
    assert guards(real) == "", "it is the first to be tried"
    assert why('plugin = "ur"\nsim = true') == ""
    assert why('plugin = "virtual"', there) == "it has no emergency stop"
    assert why('plugin = "ati-netft"\nsim = true') == "its simulator has no emergency stop"
