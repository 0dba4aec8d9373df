"""The CANopen arm on drives that count in units of their own, judged by what their motors really do."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.units import TURN
from crtk_drivers.errors import ConfigError
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import arm_of, device_of, drives, patient_arm_on, start_anew
from rigs.waiting import LONG, eventually

GEAR = 100.0
COUNTS = 65536
MAKES = ("technosoft", "kinco", "roboteq", "ax2000", "zlac8015d", "epos4")
JOINT: dict[str, Any] = {
    "gear": GEAR,
    "counts_per_turn": float(COUNTS),
    "velocity": 1.0,
    "acceleration": 1.0,
    "effort": 0.0,
    "modes": ("pp", "pv"),
}
EPOS4 = {**JOINT, "counts_per_turn": 2000.0, "modes": ("csp", "pp", "pv", "csv")}


@pytest.fixture(scope="module")
def makes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSim]:
    """One drive of each make, nodes from 1 on in the order of `MAKES`."""
    path = tmp_path_factory.mktemp("makes") / "drives.yaml"
    path.write_text("".join(f"{n}: {{personality: {make}}}\n" for n, make in enumerate(MAKES, 1)))
    with drives(len(MAKES), drives=str(path)) as sim:
        yield sim


@pytest.fixture
def sim(makes: RunningSim) -> RunningSim:
    """These drives as from the factory."""
    makes.control.inject("reset")
    eventually(lambda: _nmt(makes) == {"pre_operational"}, "they are up")
    return makes


def _nmt(sim: RunningSim) -> set[str]:
    return {drive["nmt"] for drive in sim.control.status()["drives"].values()}


def held(sim: RunningSim, node: int, index: int, sub: int = 0) -> int:
    return int(sim.control.call("object", node=node, index=index, sub=sub))


def joint_of(make: str, **keys: Any) -> dict[str, Any]:
    joint = EPOS4 if make == "epos4" else {**JOINT, "profile": make}
    return {"node": 1 + MAKES.index(make), **joint, **keys}


def moved(sim: RunningSim, make: str) -> float:
    """Seconds that the motor takes for 1.5 rad in a move of its drive's own."""
    node = 1 + MAKES.index(make)
    joint = {**_limits(), **joint_of(make, velocity=3.0)}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint}, moves="drives")) as arm:
        arm.enable(LONG)
        start = _turned(sim, node)
        move = arm.move_jr([1.5])
        eventually(lambda: abs(_turned(sim, node) - start) > 0.01, "it goes")
        began = time.monotonic()
        eventually(lambda: abs(_turned(sim, node) - start) > 1.49, "it is there")
        seconds = time.monotonic() - began
        move.wait(LONG)
    return seconds


def _turned(sim: RunningSim, node: int) -> float:
    axis = sim.control.status()["drives"][str(node)]["axes"][0]
    return float(axis["revolutions"]) * TURN / GEAR


def _limits() -> dict[str, float]:
    return {"lower": -10.0, "upper": 10.0, "following_error": 1.0}


@pytest.mark.parametrize("make", MAKES)
def test_a_move_has_the_acceleration_of_the_limit(sim: RunningSim, make: str) -> None:
    """2.2 s with 1 rad/s²; half a second with a thousand times that."""
    assert moved(sim, make) == pytest.approx(2.2, rel=0.3)


@pytest.mark.parametrize("make", MAKES)
def test_measured_velocity_is_that_of_the_motor(sim: RunningSim, make: str) -> None:
    node = 1 + MAKES.index(make)
    joints = {"a": {**_limits(), **joint_of(make, modes=("pv",))}}
    with arm_of(patient_arm_on(sim, 0, joints=joints)) as arm:
        arm.enable(LONG)

        def is_as_asked() -> bool:
            arm.servo_jv([0.5])
            return abs(float(arm.measured_js().velocity[0]) - 0.5) < 0.02

        eventually(is_as_asked, "it tells the velocity that was asked for")
        first, began = _turned(sim, node), time.monotonic()
        while time.monotonic() < began + 0.5:
            arm.servo_jv([0.5])
            time.sleep(0.01)
        rate = (_turned(sim, node) - first) / (time.monotonic() - began)
        assert rate == pytest.approx(0.5, rel=0.1)
        assert not [n.text for n in arm.health().notes if "606Ch" in n.text]


def test_ramps_are_written_in_the_unit_of_the_make(sim: RunningSim) -> None:
    """1 rad/s² is 1043 counts a ms squared times 1e-6, 16.16: not 1000 times that."""
    counts = GEAR * COUNTS / TURN  # for 1 rad
    wanted = {
        "technosoft": counts * 65536 / 1e6,
        "kinco": counts * 65536 / 4e6,
        "roboteq": 600.0 * GEAR / TURN,
        "ax2000": 1000.0,
        "zlac8015d": 1000.0,
        "epos4": 60.0 * GEAR / TURN,
    }
    joints = {make: {**_limits(), **joint_of(make)} for make in MAKES}
    with arm_of(patient_arm_on(sim, 0, joints=joints, moves="drives", period=0.02)):
        for make, value in wanted.items():
            for index in (0x6083, 0x6084):
                assert held(sim, 1 + MAKES.index(make), index) == round(value), (make, index)


def test_homing_ramps_have_the_same_unit(sim: RunningSim) -> None:
    homing = {"method": 37, "speed_switch": 0.5, "acceleration": 0.5}
    joints = {
        make: {**_limits(), **joint_of(make, homing=homing, modes=("pv",))}
        for make in ("technosoft", "ax2000")
    }
    with arm_of(patient_arm_on(sim, 0, joints=joints)):
        counts = GEAR * COUNTS / TURN
        assert held(sim, 1, 0x609A) == round(0.5 * counts * 65536 / 1e6)
        assert held(sim, 4, 0x609A) == 1000  # ms to 0.5 rad/s


# ------------------------------------------------------------------------------- units by the keys


@contextmanager
def not_connected(sim: RunningSim, *words: str, **joint: Any) -> Iterator[None]:
    """The arm says so, and does not get connected."""
    robot = LocalDevice(
        Session(PLUGIN, patient_arm_on(sim, 0, joints={"a": {**_limits(), **joint}}))
    )
    try:
        robot._session.start()
        for text in words:
            eventually(
                lambda text=text: text in robot.operating_state().detail,  # type: ignore[misc]
                f"{text}: {robot.operating_state().detail}",
            )
        assert not robot.engine.connected
        yield
    finally:
        robot.close()


def test_velocities_alone_do_not_tell_accelerations(sim: RunningSim) -> None:
    """Nobody says what 6083h counts in: it is asked for, and nothing is written."""
    before = held(sim, 1, 0x6083)
    scale = TURN / (COUNTS * GEAR) * 1000.0 / 65536.0
    joint = joint_of("technosoft", profile="none", velocity_scale=scale)
    with not_connected(sim, "6083h", "Give `acceleration_scale`", **joint):
        assert held(sim, 1, 0x6083) == before


def test_the_keys_give_what_no_profile_does(sim: RunningSim) -> None:
    count = TURN / (COUNTS * GEAR)
    keys = {
        "profile": "none",
        "velocity_scale": count * 1000.0 / 65536.0,
        "acceleration_scale": count * 1e6 / 65536.0,
    }
    joint = {**_limits(), **joint_of("technosoft", **keys)}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint}, moves="drives")):
        assert held(sim, 1, 0x6083) == round(65536.0 / 1e6 / count)


def test_an_acceleration_a_thousand_times_off_is_refused(sim: RunningSim) -> None:
    """The unit of velocities, given for accelerations too: a limit would be written 1000 times too large."""
    count, before = TURN / (COUNTS * GEAR), held(sim, 1, 0x6083)
    scale = count * 1000.0 / 65536.0
    keys = {"profile": "none", "velocity_scale": scale, "acceleration_scale": scale}
    words = ("6085h", "in the unit that is used", "limit is 1 rad/s²", "`acceleration_scale`")
    with not_connected(sim, *words, **joint_of("technosoft", **keys)):
        assert held(sim, 1, 0x6083) == before


def test_what_is_not_plausible_can_be_allowed(sim: RunningSim) -> None:
    sim.control.call("object", node=5, index=0x607F, value=1)
    keys = {"plausibility": "note", "modes": ("csp",)}
    joint = {**_limits(), **joint_of("zlac8015d", **keys)}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint})) as arm:
        assert "607Fh" in " ".join(note.text for note in arm.health().notes)


@pytest.mark.parametrize("make", MAKES)
def test_a_limit_far_below_the_motor_can_be_allowed(sim: RunningSim, make: str) -> None:
    """Whoever tries a joint first gives it a small part of what its motor can."""
    slow = {"velocity": 1 / 30, "acceleration": 1 / 30, "modes": ("pp",), "plausibility": "note"}
    joint = {**_limits(), **joint_of(make, **slow)}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint}, moves="drives")) as arm:
        arm.enable(LONG)
        first, began = _turned(sim, joint["node"]), time.monotonic()
        arm.move_jr([0.02]).wait(LONG)
        assert _turned(sim, joint["node"]) - first == pytest.approx(0.02, abs=2e-3)
        assert time.monotonic() - began > 1.0


def test_slow_ramps_are_no_doubt_where_others_show_the_unit(sim: RunningSim) -> None:
    """As an earlier program left them, which moved two joints at once."""
    for index in (0x6083, 0x6084):
        sim.control.call("object", node=1, index=index, value=1000)
    joint = {**_limits(), **joint_of("technosoft", modes=("pv",))}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint})):
        assert held(sim, 1, 0x6083) > 60_000


def test_a_move_in_small_part_does_not_make_the_next_start_implausible(sim: RunningSim) -> None:
    """Its rates are shares of the limits, and stay in the drive."""
    joints = {
        make: {**_limits(), **joint_of(make, modes=("pp",))} for make in ("technosoft", "kinco")
    }
    config = patient_arm_on(sim, 0, joints=joints)
    with arm_of(config) as arm:
        arm.enable(LONG)
        arm.move_jr([0.3, 0.003]).wait(LONG)
    with arm_of(config):
        assert held(sim, 2, 0x6081) < held(sim, 1, 0x6081)


def test_times_of_ramps_have_a_key(sim: RunningSim) -> None:
    keys = {"profile": "none", "ramp_time_scale": 1e-3}
    joint = {**_limits(), **joint_of("ax2000", **keys)}
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint}, moves="drives")):
        assert held(sim, 4, 0x6083) == 1000


def test_units_that_nobody_tells_are_noted() -> None:
    with drives(1, personality="ax2000") as sim:
        joint = {**_limits(), **JOINT, "node": 1, "modes": ("csp", "csv")}
        with arm_of(patient_arm_on(sim, 0, joints={"a": joint})) as arm:
            notes = " ".join(note.text for note in arm.health().notes)
            assert "nobody tells the unit of velocity" in notes
            assert "give `velocity_scale`" in notes


def test_cyclic_modes_need_no_unit_of_accelerations(sim: RunningSim) -> None:
    """Velocities have one by the key, and no ramp is written."""
    joint = {**_limits(), **joint_of("roboteq", profile="none", modes=("csp", "csv"))}
    joint["velocity_scale"] = TURN / 60.0 / GEAR
    with arm_of(patient_arm_on(sim, 0, joints={"a": joint})) as arm:
        arm.enable(LONG)
        arm.move_jr([0.1]).wait(LONG)
        arm.servo_jv([0.1])


@pytest.mark.parametrize("entry", ["6083", "6084", "6081", "profile_acceleration"])
def test_a_parameter_that_would_be_overwritten_is_refused(entry: str) -> None:
    joint = {**_limits(), **JOINT, "node": 1, "parameters": {entry: 7}}
    values = {"joints": {"a": joint}, "moves": "drives"}
    with pytest.raises(ConfigError, match=r"is written from the limit .*would be overwritten"):
        PLUGIN.load_config(values, {})


def test_a_parameter_that_is_not_written_is_taken() -> None:
    joint = {**_limits(), **JOINT, "node": 1, "modes": ("csp",), "parameters": {"6083": 7}}
    PLUGIN.load_config({"joints": {"a": joint}}, {})


# ------------------------------------------------------------------- units that are told, or are not


def test_measured_velocities_in_another_unit_are_found_in_motion(sim: RunningSim) -> None:
    """606Ch in 0.1 rpm for 60FFh in rpm: ten times too fast, until the key is given."""
    rpm = TURN / 60.0 / GEAR
    keys = {"profile": "none", "modes": ("pv",), "velocity_scale": rpm, "acceleration": 5.0}
    keys["ramp_time_scale"] = 1e-3
    for measured, factor in ((None, 10.0), (0.1 * rpm, 1.0)):
        joint = {**_limits(), **joint_of("zlac8015d", **keys), "measured_velocity_scale": measured}
        with arm_of(patient_arm_on(sim, 0, joints={"a": joint})) as arm:
            arm.enable(LONG)
            device = device_of(arm)

            def judged(arm: LocalDevice = arm, device: Any = device) -> bool:
                arm.servo_jv([0.5])
                return bool(device._checks[0].judged)

            eventually(judged, "it has moved enough")
            assert device._checks[0].ratio == pytest.approx(factor, rel=0.2)
            notes = " ".join(note.text for note in arm.health().notes)
            assert ("`measured_velocity_scale`" in notes) == (factor != 1.0)


@pytest.fixture(scope="module")
def plain() -> Iterator[RunningSim]:
    with drives(1) as sim:
        yield sim


ANGLES = {0x00400000: 400.0, 0xFE400000: 40_000.0, 0xFD410000: 360_000.0, 0xFD100000: 1000.0 * TURN}
"""60A8h: gradians and hundredths of them, thousandths of degrees and radians; how many for a turn."""


@pytest.mark.parametrize("word", [0xFE400000, 0xFD410000])
def test_angles_that_positions_count_in_are_understood(plain: RunningSim, word: int) -> None:
    start_anew(plain)
    plain.control.call("object", node=1, index=0x60A8, value=word)
    joint = {**_limits(), "node": 1, "velocity": 1.0, "acceleration": 5.0, "gear": GEAR}
    joint["parameters"] = {"6065": 2**31 - 1}  # its window is in these units too
    with arm_of(patient_arm_on(plain, 0, joints={"a": joint})) as arm:
        arm.enable(LONG)
        start = _turned(plain, 1)
        arm.move_jr([0.5]).wait(LONG)
        eventually(
            lambda: abs(_turned(plain, 1) - start - 0.5) < 5e-3, "the motor has turned so far"
        )
        unit = abs(device_of(arm).link.axes[0].facts.units.position)
        assert unit == pytest.approx(TURN / ANGLES[word] / GEAR)


@pytest.mark.parametrize(
    ("index", "word", "words"),
    [
        (0x60A8, 0x00AC0000, ("60A8h is 0x00AC0000", "Give `scale`")),
        (0x60A8, 0xFDC10000, ("60A8h is 0xFDC10000", "Give `scale`")),
        (0x60A9, 0x00B44B00, ("60A9h is 0x00B44B00", "Give `velocity_scale`")),
        (0x60A9, 0x00010300, ("60A9h is 0x00010300", "Give `velocity_scale`")),
        (0x60AA, 0x00B54B00, ("60AAh is 0x00B54B00", "Give `acceleration_scale`")),
    ],
)
def test_units_that_are_not_understood_are_refused(
    plain: RunningSim, index: int, word: int, words: tuple[str, ...]
) -> None:
    start_anew(plain)
    plain.control.call("object", node=1, index=index, value=word)
    joint = {"node": 1, "velocity": 1.0, "gear": GEAR, "modes": ("pv",)}
    with not_connected(plain, *words, **joint):
        pass


def test_an_acceleration_that_is_not_needed_needs_no_unit(plain: RunningSim) -> None:
    start_anew(plain)
    plain.control.call("object", node=1, index=0x60AA, value=0x00B54B00)
    joint = {**_limits(), "node": 1, "velocity": 1.0, "gear": GEAR}
    with arm_of(patient_arm_on(plain, 0, joints={"a": joint})) as arm:
        arm.enable(LONG)


def test_a_rail_without_a_feed_keeps_its_motor_speed(plain: RunningSim) -> None:
    """60A8h in µm says how far it goes, and nothing of how far for one turn: 6080h is no limit then."""
    start_anew(plain)
    plain.control.call("object", node=1, index=0x60A8, value=0xFA010000)
    before = held(plain, 1, 0x6080)
    joint = {"node": 1, "kind": "prismatic", "lower": -1.0, "upper": 1.0, "velocity": 0.1}
    with arm_of(patient_arm_on(plain, 0, joints={"a": {**joint, "modes": ("csp",)}})) as arm:
        assert held(plain, 1, 0x6080) == before
        assert not arm.measured_js().effort.size, "N are not known"


def test_forces_need_the_way_of_a_turn(plain: RunningSim) -> None:
    start_anew(plain)
    joint = {"node": 1, "kind": "prismatic", "velocity": 0.1, "scale": 1e-6, "modes": ("cst",)}
    with not_connected(plain, "Give `feed`", **{**joint, "effort": 20.0}):
        pass


def test_a_small_effort_limit_is_refused_where_efforts_are_sent(plain: RunningSim) -> None:
    start_anew(plain)
    joint = {**_limits(), "node": 1, "velocity": 1.0, "gear": GEAR, "effort": 1.0}
    with not_connected(plain, "6076h", **joint, modes=("cst",)):
        pass


@pytest.mark.parametrize(("mode", "plausibility"), [("csp", "refuse"), ("cst", "note")])
def test_a_small_effort_limit_is_noted(plain: RunningSim, mode: str, plausibility: str) -> None:
    start_anew(plain)
    joint = {**_limits(), "node": 1, "velocity": 1.0, "gear": GEAR, "effort": 1.0}
    joint |= {"modes": (mode,), "plausibility": plausibility}
    with arm_of(patient_arm_on(plain, 0, joints={"a": joint})) as arm:
        assert "6076h" in " ".join(note.text for note in arm.health().notes)


def test_one_count_a_turn_is_a_default_and_refused(plain: RunningSim) -> None:
    start_anew(plain)
    plain.control.call("object", node=1, index=0x608F, sub=1, value=1)
    plain.control.call("object", node=1, index=0x6092, sub=1, value=1)
    joint = {"node": 1, "velocity": 1.0, "gear": GEAR}
    with not_connected(plain, "1 count for a turn", "Give `counts_per_turn`", **joint):
        pass
