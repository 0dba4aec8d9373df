"""The bench over a simulated force sensor on an arm: its figures, its proof, and the watch over both."""

from __future__ import annotations

import math
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Subject, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, Carrier, lacking
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.run import judged_again
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.loopback import LoopbackDevice
from crtk_sim_backends.netft.defects import TransducerDefects
from rigs import stepped_bed
from rigs.bench_lab import ARM, ARM_200, FT, carried_out, measured, of_sensor, with_defects
from rigs.processes import process_of
from rigs.proof_table import tell_proof, tell_stored
from rigs.waiting import eventually

BY_ID = {test.id: test for test in TESTS}

Tell = Callable[[str, object], None]


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_sound_sensor_on_an_arm_fails_nowhere(tmp_path: Path, record_property: Tell) -> None:
    ids = ("F2", "F3", "F4", "F5", "F6", "X1", "X2")
    run = carried_out(tmp_path, with_defects("noise=0.05"), *ids)
    tell_stored(record_property, "", [one for _, test in run.tests for one in test.measurements])
    assert set(of_sensor(run)) == {*ids}
    assert Verdict.FAIL not in {verdict for verdict, _ in of_sensor(run).values()}, of_sensor(run)
    assert measured(run).keys() >= {
        "force.weight.mass",
        "force.frame.angle",
        "force.bias.left",
        "force.saturation.told",
        "together.motion.lag",
    }
    assert measured(run)["together.neighbours.states"] is Verdict.PASS
    assert measured(judged_again(tmp_path / "run", None)) == measured(run), "from both recordings"


@pytest.mark.slow  # data that a busy machine makes invalid say nothing of what saturates
@pytest.mark.timeout(90)
def test_a_bias_that_drifts_and_a_saturation_that_is_not_told_fail(
    tmp_path: Path, record_property: Tell
) -> None:
    defects = "drift=0.02,hides_saturation=1"
    run = carried_out(tmp_path, with_defects(defects), "F2", "F3")
    stored = [one for _, test in run.tests for one in test.measurements]
    tell_stored(record_property, defects, stored, ("force.bias.left",))
    assert measured(run)["force.bias.left"] is Verdict.FAIL, of_sensor(run)
    verdict, reason = of_sensor(run)["F3"]
    assert verdict is Verdict.FAIL, reason
    assert "saturat" in reason  # on a busy machine data may be invalid for another reason, too late


# --------------------------------------------------------------------- on an arm whose time is stepped

TOOL = Carried(0.8, (0.0, 0.02, 0.06), (0.0, 0.0, math.sin(0.5), math.cos(0.5)))
AXES = TransducerDefects(scale=1.1, exchanged=(0, 2))


@pytest.mark.parametrize(
    ("defects", "verdict"),
    [(TransducerDefects(noise=0.05), Verdict.PASS), (AXES, Verdict.FAIL)],
    ids=["sound", "scale and axes"],
)
def test_a_transducer_with_wrong_axes_and_scale_fails(
    defects: TransducerDefects, verdict: Verdict, record_property: Tell
) -> None:
    trace, subject = stepped_bed.acquired_carried(BY_ID["F4"].acquisition, TOOL, ARM_200, defects)
    found = [
        one for name in ("F4", "F5") for one in BY_ID[name].analyse(trace, subject).measurements
    ]
    quantities = [quantity.id for name in ("F4", "F5") for quantity in BY_ID[name].quantities]
    tell_proof(record_property, "" if defects is not AXES else "scale,exchanged", found, quantities)
    verdicts = {one.quantity.id: one.verdict for one in found}
    assert verdicts == dict.fromkeys(quantities, verdict)


def test_the_arm_stays_within_its_space_and_one_that_is_too_narrow_is_told() -> None:
    ranges = [{"lower": -0.2, "upper": 0.2}] * 6
    narrow = ARM_200 | {"start": [0.0] * 6, "space": {"joints": ranges}}
    trace, subject = stepped_bed.acquired_carried(BY_ID["F4"].acquisition, TOOL, narrow)
    for name in ("F4", "F5"):
        found = BY_ID[name].analyse(trace, subject)
        assert found.verdict is Verdict.INCONCLUSIVE
        assert "its space is too narrow" in found.reason, found.reason
    joints = trace.joint_states("carrier/measured_js").position
    assert np.abs(joints).max() < 0.21
    assert np.ptp(joints, axis=0).max() > 0.1, "it was turned"


SUBJECT = Subject((), (), 500.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.0)


@pytest.mark.parametrize(
    ("looks", "back", "verdict"),
    [
        ([(0.0, 1, False), (0.5, 0, False), (1.2, 2, True)], 1.2, Verdict.PASS),
        ([(0.0, 1, False), (0.5, 0, False), (1.2, 2, False), (1.3, 3, True)], 1.2, Verdict.FAIL),
        ([(0.0, 1, False), (0.5, 0, False)], None, Verdict.FAIL),
        ([(0.0, 1, False), (0.5, 2, False), (1.2, 3, False)], 1.2, Verdict.INCONCLUSIVE),
    ],
    ids=["told", "too late", "never back", "never away"],
)
def test_a_bias_that_is_trusted_after_a_power_cut_fails(
    looks: list[tuple[float, int, bool]], back: float | None, verdict: Verdict
) -> None:
    subject = replace(SUBJECT, kept={"looks": looks, "back": back})
    assert BY_ID["F6"].analyse(Trace.of([]), subject).verdict is verdict


@pytest.mark.parametrize(("after", "verdict"), [(0.2, Verdict.PASS), (0.9, Verdict.FAIL)])
def test_a_saturation_that_is_told_late_fails(after: float, verdict: Verdict) -> None:
    kept = {"before": "", "told": "saturated", "after": after, "quiet": True}
    assert BY_ID["F3"].analyse(Trace.of([]), replace(SUBJECT, kept=kept)).verdict is verdict


# ------------------------------------------------------------------------------ the watch over both


@pytest.mark.slow  # that it is stopped while it weighs is its quick brother
@pytest.mark.usefixtures("cold_bench")
@pytest.mark.timeout(120)
def test_a_sensor_that_falls_silent_stops_the_arm(tmp_path: Path) -> None:
    moving = tmp_path / "run" / "data" / "ft-weighing.carrier.mcap"

    def kill() -> None:
        eventually(lambda: moving.exists() and moving.stat().st_size > 500_000)
        os.kill(process_of("crtk_sim_backends.netft"), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    run = carried_out(tmp_path, ARM + FT, "F4")
    killer.join()
    verdict, reason = of_sensor(run)["F4"]
    assert verdict is Verdict.INCONCLUSIVE
    assert "FAULT" in reason, reason
    log = (tmp_path / "run" / "log.txt").read_text()
    assert "virtual: stopped by the watch: ati-netft" in log, log


@pytest.mark.timeout(120)
def test_stopped_while_it_weighs_the_arm_is_held(tmp_path: Path) -> None:
    stop = StopRequest()

    def progress(device: str, test: str, verdict: Verdict | None, reason: str) -> None:
        if (test, verdict) == ("F4", None):
            stop.set()

    run = carried_out(tmp_path, ARM + FT, "F4", progress=progress, stop=stop)
    assert (run.complete, run.ended_by) == (False, "stopped by the operator")
    assert of_sensor(run)["F4"][0] is Verdict.INCONCLUSIVE
    assert "virtual: stopped by the watch" in (tmp_path / "run" / "log.txt").read_text()


@pytest.mark.slow
@pytest.mark.timeout(90)
def test_an_arm_that_failed_carries_nothing_about(tmp_path: Path) -> None:
    sagging = f"{ARM}settings.defects = {{ sag_on_disable = 0.02 }}\n"
    run = carried_out(tmp_path, sagging + FT, "M1", "F4")
    verdict, reason = of_sensor(run)["F4"]
    assert verdict is Verdict.SKIPPED
    assert reason.startswith("arm, which carries it: no more after M1: FAIL"), reason


def test_a_real_arm_carries_nothing_about_unless_it_is_allowed(tmp_path: Path) -> None:
    def why(
        more: str,
        *,
        may_move: bool = True,
        may_travel: tuple[str, ...] = ("arm",),
        reached: bool = True,
        stopped: str = "",
    ) -> str:
        path = tmp_path / "lab.toml"
        address = 'settings = { host = "192.168.1.9" }'
        path.write_text(f'[devices.arm]\nplugin = "ur"\n{address}\n{more}{FT}')
        lab = load_lab(path)
        about = ABOUT if reached else None
        arm = Carrier(lab.devices["arm"], about, stopped)
        options = BenchOptions(Suite.FULL, (), may_move, tmp_path, may_travel)
        return lacking(BY_ID["F4"], ABOUT, lab.devices["ft"], options, carrier=arm)

    ranges = ", ".join(["{ lower = -1.0, upper = 1.0 }"] * 6)
    space = f"space = {{ speed = 0.5, joints = [{ranges}] }}\n"
    assert why(space) == ""
    assert why(space, may_move=False) == (
        "arm, which carries it: needs --may-move: it enables the device"
    )
    assert "needs `space.joints`" in why("space = { speed = 0.2 }\n")
    assert "needs --may-travel arm" in why(space, may_travel=())
    assert "`space` in the lab file" in why("")
    assert "was not reached" in why(space, reached=False)
    assert "no more after S1" in why(space, stopped="no more after S1")
    assert "another device" in why(f'{space}identity = {{ serial = "8" }}\n')


def test_a_simulator_that_feels_no_load_is_not_saturated(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text('[devices.arm]\nplugin = "ur"\nsim = true\n')
    options = BenchOptions(Suite.FULL, (), True, tmp_path)
    arm = load_lab(path).devices["arm"]
    assert lacking(BY_ID["F3"], ABOUT, arm, options) == "its simulator feels no load"


def test_what_nothing_carries_is_not_weighed(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(ARM + FT)
    alone = load_lab(path, only=("ft",)).devices["ft"]
    options = BenchOptions(Suite.FULL, (), True, tmp_path)
    assert "needs a device that carries it" in lacking(BY_ID["F4"], ABOUT, alone, options)


ABOUT = About(
    name="arm",
    capabilities=LoopbackDevice().capabilities,
    commands=("move_jp", "measured_js", "measured_cp", "measured_cf"),
    silence=0.1,
    sample_timeout=0.5,
    stale_after=0.05,
    max_step=0.05,
    has_kinematics=True,
    readings={"serial": "7"},
    is_homed=True,
)
