"""S6 and T8: a link that is lost, by a relay over the real wire, and what is told of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from crtk_drivers.device import Capabilities
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Subject, Suite
from crtk_drivers.labs.bench.allowed import FAULTS, BenchOptions, lacking
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.results import Run
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.loopback import ROTARY, LoopbackDevice

BY_ID = {test.id: test for test in TESTS}


def bench(folder: Path, lab: str, *only: str) -> Run:
    path = folder / "lab.toml"
    path.write_text(lab)
    options = BenchOptions(Suite.QUICK, only, may_move=False, out=folder / "run", at_once=2)
    return run_bench(load_lab(path), options, lambda *_: None, StopRequest())


DRIVE = """
[devices.drive]
plugin = "canopen"
sim = true
[devices.drive.settings]
period = 0.01

[devices.drive.settings.joints.j]
node = 1
gear = 100.0
lower = -3.0
upper = 3.0
velocity = 2.0
acceleration = 10.0
effort = 20.0
modes = ["csp", "csv"]
homing = { method = 37 }
"""


SERVOS = """
[devices.drive]
plugin = "dynamixel"
sim = true
[devices.drive.settings]
arm = "arm6"
"""

DRIVES = {"sound": "", "deaf": 'sim_options = { defects = "ignores_watchdog=1" }\n'}


def drives(folder: Path, drive: str, *only: str) -> Run:
    """Return what is found of two drives, one of which ignores its watchdog."""
    lab = "".join(
        drive.replace("drive", name).replace("sim = true\n", f"sim = true\n{options}")
        for name, options in DRIVES.items()
    )
    return bench(folder, lab, *only)


@pytest.fixture(scope="module")
def on_can(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return drives(tmp_path_factory.mktemp("drives"), DRIVE, "S4", "S5", "S6")


@pytest.fixture(scope="module")
def on_a_serial_line(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return drives(tmp_path_factory.mktemp("servos"), SERVOS, "S6")


@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize(("name", "verdict"), [("sound", Verdict.PASS), ("deaf", Verdict.FAIL)])
@pytest.mark.parametrize("bus", ["on_can", "on_a_serial_line"])
def test_a_drive_that_ignores_its_watchdog_fails(
    request: pytest.FixtureRequest, bus: str, name: str, verdict: Verdict
) -> None:
    """What stops the hardware when the driver, or the link, is gone is of the hardware."""
    run: Run = request.getfixturevalue(bus)
    tests = [test for device, test in run.tests if device.name == name]
    found = {test.id: (test.verdict, test.reason) for test in tests}
    open_or_so = {verdict, Verdict.INCONCLUSIVE}  # on a busy machine
    assert {each for each, _ in found.values()} <= open_or_so, found
    ways = [one for test in tests for one in test.measurements if "distance" in one.id]
    measured = {one.verdict for one in ways if one.value is not None}
    assert measured == {verdict}, [(one.id, one.part, one.told) for one in ways]
    is_open = found["S6"][0] is Verdict.INCONCLUSIVE
    if is_open and not any(one.id == "stop.link_lost.distance" for one in ways):
        pytest.skip(found["S6"][1])  # the machine was too busy
    cut = {one.part.partition(":")[0] for one in ways if one.id == "stop.link_lost.distance"}
    assert cut == {"deaf", "silent", "closed"}, found


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_sound_arm_and_a_sensor_fail_nowhere(tmp_path: Path) -> None:
    """Over TCP, and over UDP; what the arm tells while it hears nothing gives the time as well."""
    devices = (
        f'[devices.{name}]\nplugin = "{plugin}"\nsim = true\n'
        for name, plugin in (("arm", "ur"), ("ft", "ati-netft"))
    )
    run = bench(tmp_path, "".join(devices), "T8", "S6")
    found = {(device.name, test.id): (test.verdict, test.reason) for device, test in run.tests}
    assert Verdict.FAIL not in {verdict for verdict, _ in found.values()}, found
    assert found["ft", "S6"][0] is Verdict.SKIPPED
    measured = {
        (device.name, one.id)
        for device, test in run.tests
        for one in test.measurements
        if one.value is not None
    }
    assert ("arm", "stop.link_lost.time") in measured, found
    assert ("ft", "loss.link.fault") in measured, found


def cut(**values: Any) -> dict[str, Any]:
    stood = [(0.01 * index, [min(0.01 * index, 0.1)]) for index in range(300)]
    sound = {
        "speed": [0.1],
        "before": [0.0],
        "took": 0.002,
        "looks": stood,
        "after": [0.01],
        "later": [0.01],
        "back": True,
        "state": "FAULT",
    }
    return sound | values


SUBJECT = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)


def beyond(found: Findings) -> set[str]:
    return {
        f"{one.quantity.id} {one.part}".strip()
        for one in found.measurements
        if one.verdict is Verdict.FAIL
    }


@pytest.mark.parametrize(
    ("cuts", "failing"),
    [
        ({}, set()),
        ({"silent": {"later": [0.5], "after": [0.5]}}, {"stop.link_lost.distance silent: joint_1"}),
        ({"closed": {"after": [0.0]}}, {"stop.link_lost.after closed: joint_1"}),
        (
            {"deaf": {"looks": [(0.01 * index, [0.01 * min(index, 200)]) for index in range(300)]}},
            {"stop.link_lost.time"},
        ),
        (
            {"deaf": {"looks": [(0.01 * index, [0.01 * index]) for index in range(300)]}},
            {"stop.link_lost.time"},
        ),
    ],
    ids=["sound", "far", "afterwards", "late", "never"],
)
def test_what_is_told_of_a_lost_link_is_judged(
    cuts: dict[str, dict[str, Any]], failing: set[str]
) -> None:
    kept = {"cuts": {mode: cut(**cuts.get(mode, {})) for mode in ("deaf", "silent", "closed")}}
    found = BY_ID["S6"].analyse(Trace.of([]), replace(SUBJECT, kept=kept))
    assert beyond(found) == failing
    assert found.verdict is (Verdict.FAIL if failing else Verdict.PASS)


def test_one_that_is_never_back_fails() -> None:
    kept = {"cuts": {mode: cut(back=mode != "closed") for mode in ("deaf", "silent", "closed")}}
    found = BY_ID["S6"].analyse(Trace.of([]), replace(SUBJECT, kept=kept))
    assert found.violations == ("closed: it did not measure again within 20 s",)


def test_what_was_not_come_to_is_open_and_hides_no_failure() -> None:
    for deaf, verdict in ((cut(), Verdict.INCONCLUSIVE), (cut(later=[0.5]), Verdict.FAIL)):
        found = BY_ID["S6"].analyse(Trace.of([]), replace(SUBJECT, kept={"cuts": {"deaf": deaf}}))
        assert found.verdict is verdict


def test_the_time_is_left_out_where_nothing_is_told_without_being_asked() -> None:
    short = cut(looks=[(0.0, [0.0]), (0.01, [0.0])])
    kept = {"cuts": dict.fromkeys(("deaf", "silent", "closed"), short)}
    found = BY_ID["S6"].analyse(Trace.of([]), replace(SUBJECT, kept=kept))
    assert found.verdict is Verdict.PASS
    assert "stop.link_lost.time" not in {one.quantity.id for one in found.measurements}


LOOKS = [
    (0.01 * index, 10**9 if index < 2 else 0, "FAULT" if index > 40 else "DISABLED")
    for index in range(80)
]


@pytest.mark.parametrize(
    ("kept", "failing"),
    [
        ({}, set()),
        (
            {"looks": [(at, 10**9 + round(1e9 * at), state) for at, _, state in LOOKS]},
            {"loss.link.restamped"},
        ),
        ({"looks": [(2.0 * at, stamp, state) for at, stamp, state in LOOKS]}, {"loss.link.fault"}),
        (
            {"looks": [(at, 10**9 if at < 0.3 else 0, state) for at, _, state in LOOKS]},
            {"loss.link.invalid"},
        ),
        ({"back": 11.0}, {"loss.link.return"}),
    ],
)
def test_what_is_told_of_a_silent_link_is_judged(kept: dict[str, Any], failing: set[str]) -> None:
    subject = replace(SUBJECT, kept={"looks": LOOKS, "back": 1.0, "state": "FAULT", **kept})
    found = BY_ID["T8"].analyse(Trace.of([]), subject)
    assert beyond(found) == failing
    assert found.verdict is (Verdict.FAIL if failing else Verdict.PASS)


def test_what_is_never_told_and_never_back_fails() -> None:
    looks = [(at, stamp, "DISABLED") for at, stamp, _ in LOOKS]
    subject = replace(SUBJECT, kept={"looks": looks, "back": None, "state": "FAULT"})
    assert BY_ID["T8"].analyse(Trace.of([]), subject).violations == (
        "until FAULT: never",
        "it did not measure again within 20 s: FAULT",
    )


def test_a_link_to_hardware_is_cut_with_two_switches_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capabilities: Capabilities = LoopbackDevice().capabilities
    about = About(
        name="arm",
        capabilities=capabilities,
        commands=("servo_jp", "move_jp", "hold", "measured_js", "setpoint_js"),
        silence=0.1,
        sample_timeout=0.5,
        stale_after=0.05,
        max_step=0.05,
        has_kinematics=True,
        readings={},
        is_homed=True,
    )

    def why(plugin: str, test_id: str = "S6", *, may_move: bool = True) -> str:
        path = tmp_path / "lab.toml"
        path.write_text(f"{head}[devices.arm]\n{plugin}\nspace = {{ speed = 0.2 }}\n")
        lab = load_lab(path)
        options = BenchOptions(Suite.FULL, (), may_move, tmp_path)
        return lacking(
            BY_ID[test_id], about, lab.devices["arm"], options, faults=lab.settings.faults
        )

    arm = 'plugin = "ur"\nsettings = { host = "192.168.1.9" }'
    monkeypatch.delenv(FAULTS, raising=False)
    head = ""
    assert why(arm).startswith("needs `faults = true` in the lab file")
    head = "faults = true\n"
    assert why(arm).startswith("needs CRTK_BENCH_FAULTS=1")
    monkeypatch.setenv(FAULTS, "1")
    assert why(arm) == ""
    assert why(arm, "T8") == ""
    assert "--may-move" in why(arm, may_move=False)
    assert why(arm, "S4") == "is done to simulators only"
    head = ""
    assert why(arm).startswith("needs `faults = true` in the lab file"), "one switch is none"
    servos = 'plugin = "dynamixel"\nsettings = {{ port = "{}", arm = "arm6" }}'
    assert why(servos.format("/dev/x")).startswith("needs `faults = true`")
    assert "nothing that a relay could cut" in why(servos.format("socket://192.168.1.9:4000"))
    assert why('plugin = "dynamixel"\nsim = true') == ""
    assert why('plugin = "ur"\nsim = true') == ""
