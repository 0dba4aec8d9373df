"""A bench that cannot fail proves nothing: with its defect a test fails, by the measurement that is for it.

The same arm without a defect fails nowhere. Where the machine is too busy a test says so, and decides
nothing; of that its measurements know nothing, and these are looked at here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_drivers.commands import COMMANDS
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.labs.bench.acquisition import Safety, Subject
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.samples import JointState, Text, Wrench, vector
from crtk_drivers.testing.loopback import ROTARY
from rigs import bench_bed, stepped_bed
from rigs.proof_table import tell_proof

ACQUISITIONS = {test.acquisition.name: test.acquisition for test in TESTS}
BY_ID = {test.id: test for test in TESTS}

PROOFS: list[tuple[str, dict[str, Any], tuple[str, ...]]] = [
    ("rest", {"slow": 0.9}, ("sampling.rate.error",)),
    (
        "rest",
        {"lost_samples": 0.05, "position_drift": 0.005},
        ("sampling.rate.gaps", "sampling.jitter.late", "joints.noise.drift"),
    ),
    ("rest", {"jitter": 0.002, "age": 0.008}, ("sampling.jitter.p99", "sampling.age.p99")),
    ("rest", {"stamp_jitter": 0.004}, ("sampling.stamps.order",)),
    ("rest", {"clock_drift": 5000.0}, ("sampling.stamps.slope", "sampling.stamps.future")),
    ("transitions", {"hunting": 0.002}, ("joints.hunting.line",)),
    (
        "transitions",
        {"jump_on_enable": 0.01, "sag_on_disable": 0.02},
        ("staying.enable.moved", "staying.disable.moved"),
    ),
    (
        "sines",
        {"frozen_share": 0.3, "velocity_scale": 0.5},
        ("sampling.frozen.share", "joints.velocity.slope"),
    ),
    ("sines", {"velocity_lag": 0.08, "gain": 0.8}, ("joints.velocity.delay", "motion.bode.gain")),
    ("sines", {"tracking_lag": 0.1}, ("motion.lag.lag",)),
    (
        "approaches",
        {"resonance": 3.0, "damping": 0.05, "calibration": 0.01},
        (
            "motion.step.overshoot",
            "motion.step.settling",
            "joints.kinematics.position",
            "joints.kinematics.orientation",
        ),
    ),
    (
        "approaches",
        {"following_offset": 0.005, "backlash": 0.006},
        ("motion.arrival.error", "motion.direction.distance"),
    ),
    ("hold", {"slow_stop": 40.0}, ("stop.hold.time", "stop.hold.distance")),
    ("silence", {"slow_stop": 40.0}, ("stop.silence.time", "stop.silence.distance")),
    ("disable", {"sag_on_disable": 0.05}, ("stop.disable.distance",)),
    ("hold", {"rebound": 0.02}, ("stop.hold.back",)),
    (
        "client_killed",
        {"slow_stop": 40.0},
        ("stop.client_killed.time", "stop.client_killed.distance"),
    ),
    ("strokes", {"effort_sign": -1, "coulomb_friction": 3.0}, ("joints.effort.work",)),
    ("random_steps", {"tracking_lag": 0.15}, ("motion.latency.delay",)),
    (
        "limits",
        {"overspeed": 1.4, "overtravel": 0.03},
        ("limits.speed.peak", "limits.range.beyond"),
    ),
    ("ranges", {"position_jump": 0.009, "jump_at": 0.5}, ("joints.range.step",)),
    ("homings", {"homing_noise": 0.001}, ("joints.homing.spread",)),
    (
        "lines",
        {"line_bow": 0.003, "speed_ripple": 0.2},
        ("motion.line.distance", "motion.line.ripple"),
    ),
    (
        "endurance",
        {"position_drift": 5e-4, "lost_samples": 0.05},
        ("motion.endurance.drift", "motion.endurance.late"),
    ),
]
"""Acquisition, defects of a virtual arm, and the measurements that must fail by them."""

PAN_TILT = {"urdf": str(Path(__file__).parents[1] / "data" / "pan_tilt.urdf"), "acceleration": 10.0}

ARMS: dict[str, dict[str, Any]] = {
    "limits": PAN_TILT,
    "ranges": PAN_TILT,
    "homings": {"needs_homing": True},
}
"""Those that go through ranges: short ones of few joints; and one that homes."""

RATE, RATES = 200.0, {"sines": 500.0}
"""Hz of the arms: of a sine a stream is to be smooth."""

BRIEF = 0.1
"""How thorough what otherwise takes minutes is here."""

ELSEWHERE = {
    "sampling.stamps.together": "what is derived has the stamp of its source by construction",
    "motion.rate.seen": "test_commands_that_are_not_carried_out_are_missed",
    "motion.rate.age": "test_commands_that_are_not_carried_out_are_missed",
    "staying.refusals.refused": "test_what_is_accepted_though_it_is_wrong_fails",
    "staying.refusals.reasons": "test_what_is_accepted_though_it_is_wrong_fails",
    "staying.refusals.moved": "test_what_is_accepted_though_it_is_wrong_fails",
    **dict.fromkeys(
        (
            *("together.motion.lag", "together.neighbours.late", "together.neighbours.states"),
            *("force.weight.mass", "force.weight.center", "force.weight.residual"),
            *("force.frame.angle", "force.bias.left", "force.saturation.told"),
            "force.power.trusted",
        ),
        "test_bench_forces and test_bench_together",
    ),
    "tracking.hand_eye.residual": "test_bench_marked",
    "tracking.hand_eye.turn": "test_bench_marked",
    "force.noise.mains": "test_the_mains_in_a_force_sensor_are_found",
    "stop.driver_killed.distance": "test_bench_links.test_a_drive_that_ignores_its_watchdog_fails",
    "stop.driver_frozen.distance": "test_bench_links.test_a_drive_that_ignores_its_watchdog_fails",
    "stop.driver_frozen.after": "no defect of a simulator moves it when the driver goes on",
    "loss.silence.restamped": "test_what_is_told_of_a_silent_device_is_judged",
    "loss.silence.invalid": "test_what_is_told_of_a_silent_device_is_judged",
    "loss.silence.fault": "test_what_is_told_of_a_silent_device_is_judged",
    "loss.return.time": "test_what_is_told_of_a_silent_device_is_judged",
    "loss.return.moved": "test_what_is_told_of_a_silent_device_is_judged",
    "stop.link_lost.time": "test_bench_links.test_what_is_told_of_a_lost_link_is_judged",
    "stop.link_lost.distance": "test_bench_links.test_a_drive_that_ignores_its_watchdog_fails",
    "stop.link_lost.after": "test_bench_links.test_what_is_told_of_a_lost_link_is_judged",
    **dict.fromkeys(
        ("stop.emergency.time", "stop.emergency.distance", "stop.emergency.after"),
        "test_bench_operated.test_what_an_emergency_stop_did_is_judged",
    ),
    "loss.link.restamped": "test_bench_links.test_what_is_told_of_a_silent_link_is_judged",
    "loss.link.invalid": "test_bench_links.test_what_is_told_of_a_silent_link_is_judged",
    "loss.link.fault": "test_bench_links.test_what_is_told_of_a_silent_link_is_judged",
    "loss.link.return": "test_bench_links.test_what_is_told_of_a_silent_link_is_judged",
    "stop.silence.back": "as stop.hold.back",
    **dict.fromkeys(
        (
            *("grip.stroke.error", "grip.stroke.claimed", "grip.block.known", "grip.block.kept"),
            *("tracking.view.valid", "tracking.scale.error", "tracking.cover.restamped"),
        ),
        "test_bench_parts",
    ),
    **dict.fromkeys(
        ("grip.stroke.spread", "grip.block.width"),
        "test_bench_parts.test_what_a_gripper_did_is_judged",
    ),
    "grip.force.error": "test_bench_parts.test_a_gripper_that_presses_too_little_is_found",
    "tracking.cover.return": "test_bench_parts.test_what_is_told_of_a_covered_tool_is_judged",
    "stop.client_killed.back": "as stop.hold.back",
    "joints.friction.coulomb": "test_what_efforts_say_is_friction_and_has_a_sign",
    "joints.friction.viscous": "test_what_efforts_say_is_friction_and_has_a_sign",
    "joints.friction.ripple": "test_what_efforts_say_is_friction_and_has_a_sign",
    "motion.endurance.refused": "test_what_is_refused_in_a_long_run_is_counted",
    "stop.disable.back": "as stop.hold.back",
    "stop.disable.time": "as stop.hold.time; its bound is the second in which the driver itself says FAULT",
}
"""Judged measurements that have no line above, and why."""


BUSY = 0.02
"""Seconds by which the bench may be late, else something may be left unmeasured."""


def verdict_of(findings: list[Findings], quantity: str) -> Verdict:
    """Return the worst verdict of a quantity, whatever the machine did meanwhile."""
    measured = [one for each in findings for one in each.measurements]
    verdicts = [one.verdict for one in measured if one.quantity.id == quantity]
    assert verdicts, f"{quantity} was not measured: {[each.reason for each in findings]}"
    return Verdict.FAIL if Verdict.FAIL in verdicts else verdicts[0]


IN_REAL_TIME = ("client_killed",)
"""Acquisitions with another process; of the others the time is stepped."""


def acquired(name: str, defects: dict[str, Any], folder: Path) -> tuple[Trace, Subject]:
    """Carry out an acquisition over a virtual arm with defects; return what its analyses are given."""
    values = {
        "rate": RATES.get(name, RATE),
        **ARMS.get(name, {}),
        **({"defects": defects} if defects else {}),
    }
    if name in IN_REAL_TIME:
        return bench_bed.acquired(ACQUISITIONS[name], "virtual", values, folder)
    thorough = BRIEF if name == "endurance" else 1.0
    return stepped_bed.acquired(ACQUISITIONS[name], "virtual", values, thorough)


def of_loopback(test: str, thorough: float = 1.0) -> Findings:
    """Return what a test finds of a gantry in memory."""
    acquisition = BY_ID[test].acquisition
    trace, subject = stepped_bed.acquired(acquisition, "loopback", {"rate": RATE}, thorough)
    return BY_ID[test].analyse(trace, subject)


def test_every_judged_measurement_has_its_proof() -> None:
    judged = {
        quantity.id
        for test in TESTS
        for quantity in test.quantities
        if quantity.comparison.value != "told"
    }
    proved = {quantity for _, _, quantities in PROOFS for quantity in quantities}
    assert judged == proved | set(ELSEWHERE)
    assert not proved & set(ELSEWHERE)


CASES = [
    pytest.param(
        *proof, id=",".join(proof[1]), marks=pytest.mark.slow
    )  # a real process, in real time
    if proof[0] in IN_REAL_TIME
    else pytest.param(*proof, id=",".join(proof[1]))
    for proof in PROOFS
]


@pytest.mark.sweep(6)
@pytest.mark.parametrize(("name", "defects", "quantities"), CASES)
def test_a_defect_makes_its_test_fail(
    name: str,
    defects: dict[str, Any],
    quantities: tuple[str, ...],
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    trace, subject = acquired(name, defects, tmp_path)
    findings = [test.analyse(trace, subject) for test in TESTS if test.acquisition.name == name]
    measurements = [one for each in findings for one in each.measurements]
    late = subject.too_busy(BUSY) if name in IN_REAL_TIME else ()
    if late and not {one.quantity.id for one in measurements}.issuperset(quantities):
        pytest.skip(late[0])
    told = [one.told for one in measurements]
    tell_proof(record_property, ",".join(defects), measurements, quantities)
    verdicts = {quantity: verdict_of(findings, quantity) for quantity in quantities}
    assert set(verdicts.values()) == {Verdict.FAIL}, (verdicts, told)


IN_PROCESS = [
    name
    for name, found in ACQUISITIONS.items()
    if (found.safety < Safety.FAULT or name == "client_killed")
    and not found.carrier_needs
    and COMMANDS.keys() >= {*found.needs}
]
"""Those of an arm by itself that take away no process, or one that is not the device's."""


@pytest.mark.sweep(5)
@pytest.mark.parametrize("name", IN_PROCESS)
def test_a_sound_arm_fails_nowhere(
    name: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    trace, subject = acquired(name, {}, tmp_path)
    for test in TESTS:
        if test.acquisition.name == name:
            findings = test.analyse(trace, subject)
            if findings.verdict is Verdict.PASS:
                tell_proof(record_property, "", findings.measurements)
            assert findings.verdict is not Verdict.FAIL, f"{test.id}: {findings.reason}"
            is_open = findings.verdict is Verdict.INCONCLUSIVE
            assert not is_open or name in IN_REAL_TIME, f"{test.id}: {findings.reason}"


def test_what_is_accepted_though_it_is_wrong_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Engine, "submit", lambda *_: None)
    findings = of_loopback("S8")
    assert findings.verdict is Verdict.FAIL
    assert verdict_of([findings], "staying.refusals.refused") is Verdict.FAIL
    assert "servo_jp that is not_finite was accepted" in findings.violations


def test_commands_that_are_not_carried_out_are_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    submit, count = Engine.submit, iter(range(10**9))

    def sometimes(self: Engine, name: str, *rest: Any) -> object:
        if name == "servo_jp" and next(count) % 3 == 0:
            return None
        return submit(self, name, *rest)

    monkeypatch.setattr(Engine, "submit", sometimes)
    findings = of_loopback("M7")
    assert verdict_of([findings], "motion.rate.seen") is Verdict.FAIL


def test_the_mains_in_a_force_sensor_are_found() -> None:
    random = np.random.default_rng(4)
    subject = replace(SUBJECT, rate=500.0)
    for amplitude, verdict in ((0.0, Verdict.PASS), (0.1, Verdict.FAIL)):
        rows: list[Row] = []
        for index in range(2000):
            force = random.normal(0.0, 0.02, 3) + amplitude * math.sin(0.2 * math.pi * index)
            at = 10**18 + 2_000_000 * index
            rows.append(("measured_cf", at, at, Wrench(vector(force), vector((0.0, 0.0, 0.0)))))
        findings = BY_ID["F1"].analyse(Trace.of(rows), subject)
        assert verdict_of([findings], "force.noise.mains") is verdict


def stroked(coulomb: float, viscous: float, sign: float = 1.0) -> Trace:
    """Return the recording of strokes of one joint with a weight, friction, and a ripple of its effort."""
    rows: list[Row] = []
    clock = 10**18

    def event(text: str) -> None:
        told = Text(json.dumps({"kind": "mark", "text": text}))
        rows.append(("events", clock, clock, told))

    for seconds in (0.5, 0.5, 1.0, 1.0, 2.0, 2.0):
        event("begin")
        for index in range(round(200.0 * (2.0 * seconds + 0.6))):
            t = 0.005 * index
            there, back = np.clip([t, t - seconds - 0.3], 0.0, seconds)
            position = 0.08 * (there - back) / seconds
            moving = float(0.0 < t < seconds) - float(0.0 < t - seconds - 0.3 < seconds)
            friction = moving * (coulomb + viscous * 0.08 / seconds)
            ripple = 0.1 * math.sin(40.0 * t)
            effort = sign * (5.0 * math.cos(position) + friction + ripple)
            clock += 5_000_000
            state = JointState(vector((position,)), vector((0.0,)), vector((effort,)), ("joint_1",))
            rows.append(("measured_js", clock, clock, state))
        event("end")
    return Trace.of(rows)


def test_what_efforts_say_is_friction_and_has_a_sign() -> None:
    subject = replace(SUBJECT, rate=200.0)
    for sign, verdict in ((1.0, Verdict.PASS), (-1.0, Verdict.FAIL)):
        assert BY_ID["J5"].analyse(stroked(2.0, 3.0, sign), subject).verdict is verdict
    without = BY_ID["J5"].analyse(stroked(0.0, 0.0), subject)
    assert without.verdict is Verdict.INCONCLUSIVE, "what carries a weight does no work"
    assert "too little friction" in without.reason

    told = BY_ID["J6"].analyse(stroked(2.0, 3.0), subject)
    assert told.verdict is Verdict.PASS, "it is only told"
    values = [one.estimate.value for one in told.measurements if one.estimate is not None]
    assert values == pytest.approx([2.0, 3.0, 0.1], rel=0.15)
    for quantity in BY_ID["J6"].quantities:
        bound = BoundEntry(value=0.01, lower=-0.01, because="it was oiled")
        strict = replace(subject, bounds={quantity.id: bound})
        judged = BY_ID["J6"].analyse(stroked(2.0, 3.0), strict)
        assert verdict_of([judged], quantity.id) is Verdict.FAIL


def test_what_is_refused_in_a_long_run_is_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    submit, count = Engine.submit, iter(range(10**9))

    def sometimes(self: Engine, name: str, *rest: Any) -> object:
        if name == "servo_jp" and next(count) == 100:
            raise CommandRefused(name, Reason.STREAM_OWNED, "for once")
        return submit(self, name, *rest)

    monkeypatch.setattr(Engine, "submit", sometimes)
    findings = of_loopback("M12", BRIEF)
    assert verdict_of([findings], "motion.endurance.refused") is Verdict.FAIL


def ranged(jump: float) -> Trace:
    """Return the recording of one joint that goes through its range, and is off by `jump` past 1 rad."""
    rows: list[Row] = []
    for index in range(400):
        clock = 10**18 + 10_000_000 * index
        if index in (0, 399):
            text = {"kind": "mark", "text": "end 0" if index else "begin 0"}
            rows.append(("events", clock, clock, Text(json.dumps(text))))
        position = 0.008 * index
        told = vector((position + jump * (position > 1.0),))
        rows.append(("measured_js", clock, clock, JointState(told, name=("joint_1",))))
    return Trace.of(rows)


@pytest.mark.parametrize(
    ("jump", "done", "verdict"),
    [
        (0.0, True, Verdict.PASS),
        (0.0, False, Verdict.INCONCLUSIVE),
        (-math.tau, False, Verdict.FAIL),
        (0.06, True, Verdict.FAIL),
    ],
)
def test_an_encoder_that_wraps_fails_though_its_move_broke(
    jump: float, done: bool, verdict: Verdict
) -> None:
    subject = replace(SUBJECT, kept={"left_out": {}, "done": done})
    assert BY_ID["J7"].of_kept
    assert BY_ID["J7"].analyse(ranged(jump), subject).verdict is verdict


def test_what_fails_of_times_because_programs_waited_is_open() -> None:
    """The bench's own timer may be in time while a simulator, in another process, is not.

    Each sixth sample is lost, and each tenth is old: as much of the time may have been waited.
    """
    rows: list[Row] = []
    for index in range(2000):
        stamp = 10**18 + 2_000_000 * (index + index // 5)
        at = stamp + (20_000_000 if index % 10 == 0 else 500_000)
        rows.append(("measured_js", at, stamp, JointState(position=vector([0.0]))))
    trace = Trace.of(rows)
    for test in ("T1", "T2", "T4"):
        for waited, verdict in ((0.0, "FAIL"), (0.05, "FAIL"), (0.3, "INCONCLUSIVE")):
            found = BY_ID[test].analyse(trace, replace(SUBJECT, rate=500.0, waited=waited))
            assert found.verdict == verdict, f"{test}: {found.reason}"
            measured = [one.told for one in found.measurements]
            assert measured == [
                one.told
                for one in BY_ID[test].analyse(trace, replace(SUBJECT, rate=500.0)).measurements
            ], "the figures are what was measured"
    assert "waited for a processor for 30 % of the time" in found.reason


def test_a_busy_machine_is_named_once() -> None:
    doubts = ("the machine is too busy: late", "few samples", "the machine is too busy: waited")
    found = Findings(doubts=(*doubts, doubts[0], doubts[1]))
    assert found.reason == "the machine is too busy: late; waited; few samples"


def followed(rate: float, ripple: float) -> Trace:
    """Return a sine of 1 Hz of one joint, its velocities 4 % too large, in steps with a slow stream."""
    begin, rows = 10**18, []
    for index in range(int(4.2 * rate)):
        t = index / rate
        angle = 2.0 * math.pi * t
        jump = ripple * (-1.0) ** (index // 2) * math.cos(angle)
        state = JointState(
            position=vector([0.05 * math.sin(angle)]),
            velocity=vector([0.1 * math.pi * (1.04 * math.cos(angle) + jump)]),
        )
        at = begin + round(1e9 * t)
        rows.append(("measured_js", at, at, state))
    notes = json.dumps({"frequencies": [1.0], "amplitude 1": [0.05]})
    for t, kind, text in ((0.0, "mark", "begin 1"), (4.1, "mark", "end 1"), (4.1, "note", notes)):
        at = begin + round(1e9 * t)
        rows.append(("events", at, at, Text(json.dumps({"kind": kind, "text": text}))))
    return Trace.of(rows)


def test_a_velocity_that_steps_with_a_stream_is_known_to_its_steps() -> None:
    """The same steps in each period make a mean that is off, and that repeats."""
    for ripple, verdict in ((0.0, Verdict.FAIL), (1.0, Verdict.INCONCLUSIVE)):
        found = BY_ID["J3"].analyse(followed(100.0, ripple), SUBJECT)
        assert verdict_of([found], "joints.velocity.slope") is verdict, found.reason


def test_what_fails_of_all_samples_fails_on_any_machine() -> None:
    rows: list[Row] = []
    for index in range(2000):
        stamp = 10**18 + 2_000_000 * index
        rows.append(("measured_js", stamp + 20_000_000, stamp, JointState(position=vector([0.0]))))
    subject = replace(SUBJECT, rate=500.0, waited=0.4)
    assert BY_ID["T4"].analyse(Trace.of(rows), subject).verdict is Verdict.FAIL


LOOKS = [
    (0.01 * index, 10**9 if index < 2 else 0, "FAULT" if index > 40 else "ENABLED")
    for index in range(80)
]
SUBJECT = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
SILENT = {"looks": LOOKS, "back": 1.0, "state": "DISABLED", "before": [0.0], "after": [0.0]}


@pytest.mark.parametrize(
    ("kept", "failing"),
    [
        ({}, set()),
        (
            {"looks": [(at, 10**9 + round(1e9 * at), state) for at, _, state in LOOKS]},
            {"loss.silence.restamped", "loss.silence.invalid"},
        ),
        ({"looks": [(at, stamp, "ENABLED") for at, stamp, _ in LOOKS]}, {"loss.silence.fault"}),
        (
            {"looks": [(2.0 * at, stamp, state) for at, stamp, state in LOOKS]},
            {"loss.silence.fault"},
        ),
        ({"back": 11.0}, {"loss.return.time"}),
        ({"after": [0.01]}, {"loss.return.moved"}),
    ],
)
def test_what_is_told_of_a_silent_device_is_judged(kept: dict[str, Any], failing: set[str]) -> None:
    subject = replace(SUBJECT, kept={**SILENT, **kept})
    found = [BY_ID[name].analyse(Trace.of([]), subject) for name in ("T6", "T7")]
    measured = [one for each in found for one in each.measurements]
    beyond = {one.quantity.id for one in measured if one.verdict is not Verdict.PASS}
    assert beyond == failing
    assert any(each.verdict is Verdict.FAIL for each in found) == bool(failing)


def test_what_comes_back_in_another_state_or_never_fails() -> None:
    for kept in ({"state": "ENABLED"}, {"back": None}):
        subject = replace(SUBJECT, kept={**SILENT, **kept})
        assert BY_ID["T7"].analyse(Trace.of([]), subject).verdict is Verdict.FAIL
