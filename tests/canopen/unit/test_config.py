"""Configuration of CANopen joints, their units, and the PDOs that follow from it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.drive_profile import DriveProfile
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.layout import plan
from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.objects import parse_object
from crtk_driver_canopen.pdo import Direction
from crtk_driver_canopen.unit_table import UNITS, Quantity
from crtk_driver_canopen.units import (
    GroupUnits,
    JointUnits,
    UnitObjects,
    interpolation_period,
    resolve,
)
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError

TURN = 2.0 * math.pi
LIMITS = {"lower": -3.0, "upper": 3.0, "velocity": 2.0}


def joint(**keys: Any) -> JointConfig:
    return load(JointConfig, from_values({"node": 1, **LIMITS, **keys}))


def arm(count: int = 2, joint_keys: dict[str, Any] | None = None, **keys: Any) -> CanopenConfig:
    joints = {
        f"joint_{n}": {"node": n, **LIMITS, **(joint_keys or {})} for n in range(1, count + 1)
    }
    return load(CanopenConfig, from_values({"joints": joints, **keys}))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"joints": {"elbow": {"node": 1}}}, "joints.elbow.lower: is required"),
        ({"joints": {"elbow": {"node": 128, **LIMITS}}}, "joints.elbow.node: must be"),
        (
            {"joints": {"elbow": {"node": 1, **LIMITS, "lower": 4.0}}},
            "joints.elbow: lower .4. must be",
        ),
        ({"joints": {"elbow": {"node": 1, **LIMITS, "modes": ["csq"]}}}, "Did you mean 'csv'"),
        ({"joints": {"elbow": {"node": 1, **LIMITS, "modes": ["csp", "csp"]}}}, "none twice"),
        ({"joints": {"elbow": {"node": 1, **LIMITS, "feed": 0.01}}}, "only for a prismatic"),
        (
            {"joints": {"elbow": {"node": 1, **LIMITS, "scale": 1.0, "counts_per_turn": 5.0}}},
            "joints.elbow: give scale or counts_per_turn",
        ),
        (
            {"joints": {"elbow": {"node": 1, **LIMITS, "homing": {"method": 16}}}},
            "joints.elbow.homing.method: there is no homing method 16",
        ),
        (
            {"joints": {"elbow": {"node": 1, **LIMITS, "parameters": {"velocity_actul": 3}}}},
            "joints.elbow.parameters: 'velocity_actul' is no object: did you mean 'velocity_actual'",
        ),
        (
            {"joints": {"elbow": {"node": 1, **LIMITS, "gera": 3.0}}},
            "Did you mean 'joints.elbow.gear'",
        ),
        (
            {"joints": {"a": {"node": 1, **LIMITS}, "b": {"node": 1, **LIMITS}}},
            "joints.b: node 1, axis 0 is also that of a",
        ),
        (
            {"joints": {"a": {"node": 127, **LIMITS}}},
            "joints.a.node: 127 is the id of this computer",
        ),
        (
            {
                "joints": {
                    "a": {"node": 1, **LIMITS, "identity": {"serial": 5}},
                    "b": {"node": 1, "axis": 1, **LIMITS},
                }
            },
            "joints.b.identity: differs from that of a",
        ),
        ({"period": 0.0012345}, "1.2345 ms is not 1 to 255 times"),
        ({"sync_counter": 1}, "goes up to 2 at least"),
        ({"heartbeat": {"ours": 0.1, "ours_timeout": 0.15}}, "ours_timeout .* at least twice"),
        ({"heartbeat": {"drives": 0.0}}, "drives_timeout needs heartbeats"),
    ],
)
def test_what_cannot_be_is_refused_and_names_the_joint(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(CanopenConfig, from_values(keys))


def test_defaults() -> None:
    config = arm(6)
    assert config.nodes == (1, 2, 3, 4, 5, 6)
    assert config.kernel_sync
    assert not arm(1, bus={"interface": "slcan"}).kernel_sync
    assert config.joints["joint_1"].op_modes == (OpMode.CSP,)
    assert config.joints["joint_1"].identity.wanted.vendor is None


@pytest.mark.parametrize(
    ("text", "index", "sub"),
    [
        ("6064", 0x6064, 0),
        ("0x6064:0", 0x6064, 0),
        ("1018:4", 0x1018, 4),
        ("1A00h:0A", 0x1A00, 10),
        ("position_actual", 0x6064, 0),
        ("Position actual", 0x6064, 0),
        ("vendor-id", 0x1018, 1),
    ],
)
def test_objects_by_number_and_name(text: str, index: int, sub: int) -> None:
    assert parse_object(text) == (index, sub)


@pytest.mark.parametrize("text", ["", "60", "6064:100", "6064:0:0", "postion_actual", "12345"])
def test_what_is_no_object(text: str) -> None:
    with pytest.raises(ValueError, match="is no object"):
        parse_object(text)


# Units


@pytest.mark.parametrize(
    ("keys", "drive", "position", "velocity", "effort"),
    [
        # Encoder and gear given, nothing from the drive.
        (
            {"counts_per_turn": 4096, "gear": 100, "rated_torque": 0.5},
            {},
            TURN / 409_600,
            None,
            0.05,
        ),
        # From the drive: encoder and gear.
        ({}, {"encoder": 4096, "gear": 50, "rated_torque": 2.0}, TURN / 204_800, None, 0.1),
        # The drive's gear is 1, the mechanical one is given.
        ({"gear": 50}, {"encoder": 4096, "feed": 4096}, TURN / 204_800, None, math.nan),
        # Feed: units for one turn of the drive's shaft.
        ({}, {"encoder": 4096, "gear": 50, "feed": 360_000}, TURN / 360_000, None, math.nan),
        # A feed of 1 means that none is set.
        ({}, {"encoder": 1000, "feed": 1}, TURN / 1000, None, math.nan),
        # Thousandths of a degree.
        ({}, {"encoder": 7, "position_unit": 0xFD410000}, math.radians(0.001), None, math.nan),
        # Velocity in 0.1 rev/min of the motor (EPOS4: FF B4 47 00), position in increments.
        (
            {"gear": 10},
            {"encoder": 2000, "position_unit": 0x00B50000, "velocity_unit": 0xFFB44700},
            TURN / 20_000,
            0.1 * TURN / 60 / 10,
            math.nan,
        ),
        # Both of the shaft: degrees and degrees per second.
        (
            {},
            {"gear": 50, "position_unit": 0x00410000, "velocity_unit": 0x00410300},
            math.radians(1),
            math.radians(1),
            math.nan,
        ),
        # Against the counts, given outright.
        (
            {"scale": 1e-5, "velocity_scale": 1e-3, "sign": -1, "rated_torque": 1.0},
            {"encoder": 99, "velocity_unit": 0x00B44700},
            -1e-5,
            -1e-3,
            -0.001,
        ),
        # A spindle of 5 mm for a turn: 1 N.m makes 2 pi / 0.005 N.
        (
            {"kind": "prismatic", "feed": 0.005, "counts_per_turn": 1000, "rated_torque": 1.0},
            {},
            5e-6,
            None,
            TURN / 5.0,
        ),
        # Gradians; hundredths of an inch; thousandths of a foot.
        ({}, {"encoder": 7, "position_unit": 0x00400000}, TURN / 400, None, math.nan),
        ({"kind": "prismatic"}, {"position_unit": 0xFEC10000}, 0.000254, None, math.nan),
        ({"kind": "prismatic"}, {"position_unit": 0xFDC20000}, 0.0003048, None, math.nan),
        # Hundredths of an increment, and increments a minute.
        (
            {"gear": 10},
            {"encoder": 1000, "position_unit": 0xFEB50000, "velocity_unit": 0x00B54700},
            TURN / 1_000_000,
            TURN / 1_000_000 / 60,
            math.nan,
        ),
        # Degrees of the shaft of a spindle, 5 mm for a turn.
        (
            {"kind": "prismatic", "feed": 0.005},
            {"position_unit": 0x00410000},
            0.005 / 360,
            None,
            math.nan,
        ),
        # Torques in units of their own.
        ({"gear": 10, "effort_scale": 0.02}, {"encoder": 100}, TURN / 1000, None, 0.02),
        # Micrometres.
        ({"kind": "prismatic"}, {"position_unit": 0xFA010000}, 1e-6, None, math.nan),
    ],
)
def test_units_of_a_joint(
    keys: dict[str, Any],
    drive: dict[str, Any],
    position: float,
    velocity: float | None,
    effort: float,
) -> None:
    units = resolve("elbow", joint(**keys), UnitObjects(**drive))
    assert units.position == pytest.approx(position)
    assert units.velocity == pytest.approx(position if velocity is None else velocity)
    assert units.effort == pytest.approx(effort, nan_ok=True)


TURNS_A_MINUTE = DriveProfile.model_validate(
    {
        "velocity": {"one": 1.0, "unit": "turns/min"},
        "measured_velocity": {"one": 0.1, "unit": "turns/min"},
        "acceleration": {"one": 0.1, "unit": "turns/min/s"},
    }
)
COUNTS_OF_ITS_OWN = DriveProfile.model_validate(
    {"acceleration": {"one": 4.0, "unit": "counts/s^2"}}
)
RAMP_TIMES = DriveProfile.model_validate({"ramp_time": 0.001})
RPM = TURN / 60 / 10


@pytest.mark.parametrize(
    ("keys", "drive", "measured", "acceleration", "ramp_time"),
    [
        # Nobody tells: velocity units a second.
        ({}, {}, None, TURN / 10_000, None),
        # 60AAh: increments; degrees; turns a minute a second, as maxon writes it; a second alone.
        ({}, {"acceleration_unit": 0xFEB55700}, None, 0.01 * TURN / 10_000, None),
        ({}, {"acceleration_unit": 0x00415700}, None, math.radians(1) / 10, None),
        ({}, {"acceleration_unit": 0x00C00300}, None, RPM, None),
        ({}, {"acceleration_unit": 0x00B40300}, None, TURN / 10, None),
        # 60AAh also where velocities are given: it was never read.
        ({"velocity_scale": 1.0}, {"acceleration_unit": 0x00B55700}, None, TURN / 10_000, None),
        # Velocities given, accelerations told by nobody: not known.
        ({"velocity_scale": 1.0}, {}, None, math.nan, None),
        # The make.
        ({}, {"make": TURNS_A_MINUTE}, 0.1 * RPM, 0.1 * RPM, None),
        ({"velocity_scale": 1.0}, {"make": COUNTS_OF_ITS_OWN}, None, 4 * TURN / 10_000, None),
        ({}, {"make": RAMP_TIMES}, None, math.nan, 0.001),
        # What the drive reports comes before its make, and the keys before both.
        (
            {},
            {"make": RAMP_TIMES, "acceleration_unit": 0x00B55700},
            None,
            TURN / 10_000,
            None,
        ),
        (
            {"acceleration_scale": 3.0, "measured_velocity_scale": 2.0},
            {"make": TURNS_A_MINUTE, "acceleration_unit": 0x00B55700},
            2.0,
            3.0,
            None,
        ),
        ({"ramp_time_scale": 0.01}, {"make": TURNS_A_MINUTE}, 0.1 * RPM, math.nan, 0.01),
    ],
)
def test_units_of_accelerations_and_measured_velocities(
    keys: dict[str, Any],
    drive: dict[str, Any],
    measured: float | None,
    acceleration: float,
    ramp_time: float | None,
) -> None:
    units = resolve("elbow", joint(**{"gear": 10, **keys}), UnitObjects(encoder=1000, **drive))
    assert units.acceleration == pytest.approx(acceleration, nan_ok=True)
    assert units.ramp_time == ramp_time
    assert units.measured_velocity == (None if measured is None else pytest.approx(measured))


@pytest.mark.parametrize(
    "drive",
    [
        {"position_unit": 0x00AC0000},  # steps
        {"position_unit": 0x00010000},  # metres, of a joint that turns
        {"position_unit": 0x00C10000},  # inches, likewise
        {"velocity_unit": 0x00B40000},  # turns, for no time
        {"velocity_unit": 0x00200300},  # hertz
        {"velocity_unit": 0x00010300},  # metres
    ],
)
def test_units_that_are_not_understood_are_never_passed_over(drive: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"60A[89A]h is 0x00.* Give `"):
        resolve("elbow", joint(), UnitObjects(encoder=1000, **drive))


@pytest.mark.parametrize("word", [0x00B50000, 0x00C10300, 0x00AC5700])
def test_an_acceleration_that_is_not_understood_has_no_unit(word: int) -> None:
    """It is refused where ramps are written; a joint that needs none is not."""
    units = resolve("elbow", joint(), UnitObjects(encoder=1000, acceleration_unit=word))
    assert math.isnan(units.acceleration_step)
    assert f"60AAh is 0x{word:08X}" in units.assumed[Quantity.ACCELERATION]


def test_a_gear_that_nobody_tells_is_said() -> None:
    """Turns of the motor and its torque say nothing of a joint behind a gear."""
    keys = {"scale": 1e-5}
    rpm = UnitObjects(encoder=1000, velocity_unit=0x00B44700)
    assert resolve("a", joint(**keys), rpm).assumed.keys() == {"acceleration", "velocity", "torque"}
    counts = UnitObjects(encoder=1000, velocity_unit=0x00B50300, acceleration_unit=0x00B55700)
    assert resolve("a", joint(**keys), counts).assumed.keys() == {"torque"}
    assert not resolve("a", joint(**keys, gear=50), counts).assumed


def test_one_increment_a_turn_is_not_taken_for_one() -> None:
    with pytest.raises(ConfigError, match="reports 1 count for a turn of the motor"):
        resolve("elbow", joint(), UnitObjects(encoder=1))
    assert resolve("elbow", joint(counts_per_turn=2), UnitObjects(encoder=1)).position


@pytest.mark.parametrize(
    "keys",
    [
        {"acceleration_scale": 1.0, "ramp_time_scale": 1.0},
        {"effort_scale": 1.0, "rated_torque": 1.0},
        {"scale": 1.0, "counts_per_turn": 1.0},
    ],
)
def test_a_unit_is_given_once(keys: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="not both"):
        joint(**keys)


@pytest.mark.parametrize(
    ("keys", "message"),
    [({}, "does not tell its encoder"), ({"kind": "prismatic"}, "how far it moves")],
)
def test_units_that_nobody_tells_are_asked_for(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"joints.elbow: .*{message}"):
        resolve("elbow", joint(**keys), UnitObjects())


def group() -> GroupUnits:
    return GroupUnits(
        {
            "a": JointUnits(TURN / 4096, 0.5, TURN / 4096, 0.05),
            "b": JointUnits(-1e-3, -1.0, -1e-2, math.nan),
        }
    )


def test_a_group_is_converted_at_once() -> None:
    units = group()
    assert units.positions([1024, 500]) == pytest.approx([0.5 + TURN / 4, -1.5])
    assert units.velocities([-4096, 100]) == pytest.approx([-TURN, -1.0])
    assert units.efforts([10, 0])[0] == pytest.approx(0.5)
    assert units.velocity_counts(np.array([TURN, 1.0])) == [4096, -100]
    with pytest.raises(ValueError, match="b: effort of nan counts"):
        units.effort_counts(np.array([0.1, 0.1]))
    with pytest.raises(ValueError, match=r"a: position of .* does not fit"):
        units.position_counts(np.array([1e9, 0.0]))
    with pytest.raises(ValueError, match="b: position of nan"):
        units.position_counts(np.array([0.0, math.nan]))


def test_velocities_and_efforts_are_never_rounded_up() -> None:
    """A limit of 0.16 rad/s is 1.53 turns a minute: 2 would be beyond it, either way round."""
    rpm = TURN / 60.0
    units = GroupUnits(
        {"a": JointUnits(1e-4, 0.0, rpm, 0.1), "b": JointUnits(1e-4, 0.0, -rpm, 0.1)}
    )
    assert units.velocity_counts(np.array([0.16, 0.16])) == [1, -1]
    assert units.velocity_counts(np.array([-0.16, -0.16])) == [-1, 1]
    assert units.effort_counts(np.array([0.16, -0.16])) == [1, -1]
    exact = [float(3 * rpm), float(-7 * rpm)]
    assert units.velocity_counts(np.array(exact)) == [3, 7]


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=2, max_size=2))
def test_velocities_come_back_as_the_same_counts(counts: list[int]) -> None:
    assert group().velocity_counts(group().velocities(counts)) == counts


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=2, max_size=2))
def test_positions_come_back_as_the_same_counts(counts: list[int]) -> None:
    assert group().position_counts(group().positions(counts)) == counts


@pytest.mark.parametrize(
    ("period", "value", "exponent"),
    [(0.004, 4, -3), (0.002, 2, -3), (0.0025, 25, -4), (0.001, 1, -3), (0.1, 1, -1), (0.02, 2, -2)],
)
def test_the_interpolation_period(period: float, value: int, exponent: int) -> None:
    assert interpolation_period(period) == (value, exponent)


# PDOs


def shape(config: CanopenConfig) -> list[tuple[str, int, int, list[str]]]:
    layout = plan(config)
    return [
        (str(pdo), pdo.id, pdo.transmission, [entry.name for entry in pdo.entries])
        for pdo in (*layout.rpdos.pdos, *layout.tpdos.pdos)
    ]


def test_one_mode_needs_one_pdo_each_way() -> None:
    assert shape(arm(1, feedback=[])) == [
        ("node 1 RPDO 1", 0x201, 1, ["controlword", "target position"]),
        ("node 1 TPDO 1", 0x181, 1, ["statusword", "position actual"]),
    ]


def test_more_modes_and_slower_feedback() -> None:
    config = arm(1, {"modes": ["csp", "csv", "cst"]}, feedback_every=4)
    assert shape(config) == [
        ("node 1 RPDO 1", 0x201, 1, ["controlword", "target position", "mode of operation"]),
        ("node 1 RPDO 2", 0x301, 1, ["target velocity", "target torque"]),
        ("node 1 TPDO 1", 0x181, 1, ["statusword", "position actual", "mode of operation display"]),
        ("node 1 TPDO 2", 0x281, 4, ["velocity actual", "torque actual"]),
    ]


def test_effort_fits_beside_the_position() -> None:
    assert shape(arm(1, feedback=["effort"]))[-1] == (
        "node 1 TPDO 1",
        0x181,
        1,
        ["statusword", "position actual", "torque actual"],
    )


def test_two_axes_of_one_node() -> None:
    joints = {name: {"node": 3, "axis": axis, **LIMITS} for axis, name in enumerate("ab")}
    joints["b"] |= {"first_rpdo": 65, "first_tpdo": 65}
    config = load(CanopenConfig, from_values({"joints": joints, "feedback": []}))
    layout = plan(config)
    assert [pdo.id for pdo in layout.rpdos.pdos] == [0x203, 0x303]
    assert [pdo.communication for pdo in layout.rpdos.pdos] == [0x1400, 0x1440]
    assert layout.rpdos.pdos[1].entries[0].index == 0x6840


def test_a_node_has_four_pdos() -> None:
    joints = {str(axis): {"node": 3, "axis": axis, **LIMITS} for axis in range(3)}
    with pytest.raises(ConfigError, match=r"joints\.2: node 3 would need more than 4 TPDOs"):
        plan(load(CanopenConfig, from_values({"joints": joints})))
    joints["2"] |= {"rpdo_cob_ids": [0x681], "tpdo_cob_ids": [0x691, 0x692]}
    layout = plan(load(CanopenConfig, from_values({"joints": joints})))
    assert [pdo.id for pdo in layout.rpdos.pdos] == [0x203, 0x303, 0x681]
    assert [pdo.id for pdo in layout.tpdos.pdos] == [0x183, 0x283, 0x383, 0x483, 0x691, 0x692]
    assert [pdo.number for pdo in layout.tpdos.pdos] == [1, 2, 3, 4, 5, 6]
    assert layout.asked == ()


@pytest.mark.parametrize(
    ("cob_ids", "message"),
    [
        ([], "needs RPDO 1 of its own, but has 0 COB-IDs"),
        ([0x203], "node 3 RPDO 1 and node 4 RPDO 1 have one COB-ID, 0x203"),
        ([0x080], "cannot have the COB-ID 0x80: .* are for SYNC"),
        ([0x603], "0x601 to 0x67f are for SDO requests"),
        ([0x703], "are for heartbeats"),
        ([0x7E5], "keeps for itself"),
        ([0x800], "less than or equal"),
        ("own", "predefined"),
    ],
)
def test_cob_ids_that_are_not_free_are_refused(cob_ids: Any, message: str) -> None:
    joints = {
        "first": {"node": 3, **LIMITS},
        "second": {"node": 4, **LIMITS, "rpdo_cob_ids": cob_ids},
    }
    with pytest.raises(ConfigError, match=message):
        plan(load(CanopenConfig, from_values({"joints": joints})))


def test_cob_ids_of_the_drives_are_planned_with_once_they_are_known() -> None:
    joints = {
        str(axis): {"node": 3, "axis": axis, **LIMITS, "rpdo_cob_ids": "drive"} for axis in range(2)
    }
    config = load(CanopenConfig, from_values({"joints": joints, "feedback": []}))
    layout = plan(config)
    rpdos = [(3, Direction.RECEIVE, number) for number in (1, 2)]
    assert list(layout.asked) == rpdos
    assert [
        pdo.id for pdo in plan(config, dict(zip(rpdos, (0x6A1, 0x6A2), strict=True))).rpdos.pdos
    ] == [
        0x6A1,
        0x6A2,
    ]
    with pytest.raises(ConfigError, match="have one COB-ID, 0x6a1"):
        plan(config, dict.fromkeys(rpdos, 0x6A1))


def test_a_cycle_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ConfigError, match="of the bus; 80% are allowed"):
        plan(arm(6, period=0.002))
    assert plan(arm(6, period=0.002, feedback=[])).load.most < 0.8
    assert plan(arm(6)).load.most < 0.65


def test_the_page_has_the_table_of_units() -> None:
    page = (Path(__file__).parents[3] / "docs" / "canopen.md").read_text()
    for quantity, source in UNITS.items():
        keys, profile = (
            ", ".join(f"`{key}`" for key in each) for each in (source.keys, source.profile)
        )
        cells = (quantity, source.objects, keys, source.reported, profile, source.otherwise)
        assert f"| {' | '.join(cells)} |" in page
        assert set(source.keys) <= set(JointConfig.model_fields)
        assert set(source.profile) <= set(DriveProfile.model_fields)
