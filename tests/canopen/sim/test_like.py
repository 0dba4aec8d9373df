"""Simulated drives that are like real ones: with the objects of an EDS; a file that is none is refused."""

from pathlib import Path

import pytest

from crtk_sim_backends.canopen import SIM, ConfigError, SimConfig
from crtk_sim_backends.canopen.config import drive_configs
from crtk_sim_backends.canopen.fitting import like
from rigs.canopen_drive import COUNTS, CSP, HM, NODE, PP, PV, Bench

SHEETS = Path(__file__).parents[2] / "data" / "eds"
NO_OBJECT = 0x0602_0000
READ_ONLY = 0x0601_0002
NOT_MAPPABLE = 0x0604_0041
TOO_HIGH = 0x0609_0031


def bench(name):
    return Bench(like=like(str(SHEETS / name)))


def changed(tmp_path, old, new, name="rpm_servo.eds"):
    text = (SHEETS / name).read_text()
    assert old in text
    path = tmp_path / "changed.eds"
    path.write_text(text.replace(old, new, 1))
    return str(path)


def without(tmp_path, *sections):
    """The EDS of the servo without some of its sections."""
    parts = (SHEETS / "rpm_servo.eds").read_text().split("\n\n")
    kept = [part for part in parts if not part.startswith(tuple(f"[{s}" for s in sections))]
    assert len(kept) < len(parts)
    path = tmp_path / "less.eds"
    path.write_text("\n\n".join(kept))
    return str(path)


def test_objects_defaults_access_and_limits_are_those_of_the_file():
    servo = bench("rpm_servo.eds")
    assert servo.read(0x1018, 1) == 0x1F11
    assert servo.read(0x605A, 0, "h") == 6
    assert servo.read(0x6065) == 2000
    assert servo.read(0x6502) == 0x3A5
    assert servo.read(0x1018, 4) == NODE
    assert servo.abort_of(servo.read, 0x6072) == NO_OBJECT  # the machine has it, the drive does not
    assert servo.abort_of(servo.write, 0x6076, 0, 5) == READ_ONLY
    assert servo.abort_of(servo.write, 0x6081, 0, 50_001) == TOO_HIGH
    assert servo.read(0x2010, 0, "B") == 2  # of the vendor, and not of the machine
    servo.write(0x2010, 1, 7, "H")
    assert servo.read(0x2010, 1, "H") == 7


def test_pdos_are_mapped_as_in_the_file_and_only_what_it_says_can_be_mapped():
    servo = bench("rpm_servo.eds")
    assert servo.read(0x1600, 12) == 0
    assert servo.read(0x1A02, 2) == 0x6064_0020
    assert servo.abort_of(servo.read, 0x1404, 1) == NO_OBJECT
    servo.write(0x1800, 1, 0xC000_0180 + NODE)
    servo.write(0x1A00, 0, 0, "B")
    assert servo.abort_of(servo.write, 0x1A00, 1, 0x6076_0020) == NOT_MAPPABLE


def test_identity_and_compact_arrays_come_from_wherever_the_file_has_them():
    drive = bench("generic.eds")
    assert [drive.read(0x1018, sub) for sub in (1, 2, 3)] == [0x1F12, 0x402, 0x10001]
    assert drive.read(0x608F, 1) == 131_072
    assert drive.read(0x6092, 1) == 36_000
    assert drive.read(0x1014) == 0x80 + NODE
    assert drive.read(0x6502) == 1 << PP - 1 | 1 << PV - 1 | 1 << 7 | 1 << 8  # of its objects


@pytest.mark.parametrize(
    ("name", "per_turn"),
    [("rpm_servo.eds", 2000), ("generic.eds", 36_000), ("few_objects.eds", COUNTS)],
)
def test_a_profile_goes_where_it_is_told_in_the_units_of_the_file(name, per_turn):
    drive = bench(name)
    for index in (0x6081, 0x6083):
        assert drive.read(index) > 0  # also where the file has no default
    drive.write(0x6060, 0, PP, "b")
    for word in (0x06, 0x07, 0x0F):
        drive.write(0x6040, 0, word, "H")
    drive.write(0x607A, 0, 2 * per_turn, "i")
    drive.write(0x6040, 0, 0x1F, "H")
    drive.run(1.0)
    assert drive.read(0x6064, 0, "i") == pytest.approx(2 * per_turn, abs=0.01 * per_turn)
    assert drive.axis.motor.revolutions == pytest.approx(2.0, abs=0.01)


def test_velocities_in_rpm_turn_the_motor_that_fast():
    servo = bench("rpm_servo.eds")
    servo.write(0x6060, 0, PV, "b")
    for word in (0x06, 0x07, 0x0F):
        servo.write(0x6040, 0, word, "H")
    servo.write(0x60FF, 0, 300, "i")
    servo.run(0.5)  # 10 000 rpm/s: it is that fast after 30 ms
    assert servo.read(0x606C, 0, "i") == pytest.approx(300, abs=3)
    assert servo.axis.motor.velocity == pytest.approx(31.4, rel=0.02)


def test_a_drive_without_the_period_takes_that_of_sync(tmp_path):
    servo = Bench(like=like(without(tmp_path, "60C2")))
    servo.write(0x6060, 0, CSP, "b")
    assert servo.abort_of(servo.read, 0x60C2, 1) == NO_OBJECT
    servo.frame(0, bytes((1, NODE)))
    for _ in range(3):
        servo.now += 0.02
        servo.frame(0x80)
    assert servo.axis.period == pytest.approx(0.02)


def test_the_file_itself_is_what_the_drive_gives_as_its_eds():
    with SIM.spawn(nodes=1, from_eds=str(SHEETS / "generic.eds"), terminals=0) as sim:
        assert sim.control.call("eds", node=1) == (SHEETS / "generic.eds").read_text()
        assert sim.paths["eds"] == str(SHEETS / "generic.eds")


def test_each_drive_can_be_like_another(tmp_path):
    path = tmp_path / "drives.yaml"
    (tmp_path / "mine.eds").write_text((SHEETS / "few_objects.eds").read_text())
    path.write_text("2: {from_eds: mine.eds, motors: [{gear: 10.0}]}\n3: {serial: 7}\n")
    common = str(SHEETS / "rpm_servo.eds")
    drives = drive_configs(SimConfig(nodes=3, from_eds=common, drives=str(path)))
    names = [Path(drives[node].like.sheet.path).name for node in (1, 2, 3)]
    assert names == ["rpm_servo.eds", "mine.eds", "rpm_servo.eds"]
    assert drives[2].motors[0].gear == 10.0


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        (("6040", "6064"), "6040, 6064"),
        (("607A",), "607A"),
        (("6098", "6099"), "6098, 6099:1, 6099:2"),
        (("1018",), "1018"),
        (("60", "65"), "6040"),
    ],
)
def test_a_file_without_what_a_drive_needs_is_refused_with_what_is_missing(
    tmp_path, sections, says
):
    with pytest.raises(ConfigError, match=says):
        like(without(tmp_path, *sections))


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="profile 401, which is not CiA 402"):
        like(changed(tmp_path, "0x00020192", "0x00020191"))
    with pytest.raises(ConfigError, match="6064 has the type U32, not I32"):
        like(without_type(tmp_path))
    for text in ("", "[FileInfo]\n", "nothing", "[1000\n", "\0"):
        path = tmp_path / "no.eds"
        path.write_text(text)
        with pytest.raises(ConfigError, match=r"no\.eds: no EDS file"):
            like(str(path))
    with pytest.raises(ConfigError, match="there is no file"):
        SimConfig(from_eds=str(tmp_path / "none.eds"))
    with pytest.raises(ConfigError, match="has 1 axes, and there are 2 motors"):
        drive_configs(SimConfig(from_eds=str(SHEETS / "generic.eds"), axes=2))


def without_type(tmp_path):
    text = (SHEETS / "rpm_servo.eds").read_text()
    before, after = text.split("[6064]")
    path = tmp_path / "type.eds"
    path.write_text(before + "[6064]" + after.replace("0x0004", "0x0007", 1))
    return str(path)


def test_what_is_wrong_with_a_file_that_can_be_used_is_noted(tmp_path):
    path = changed(tmp_path, "DefaultValue=0x60640020", "DefaultValue=0x30000020")
    found = like(path)
    assert found.notes == (f"{path}: [1A02] maps 3000, which cannot be mapped: the PDO is empty",)
    drive = Bench(like=found)
    assert drive.read(0x1A02, 0, "B") == 0
    path = changed(tmp_path, "DefaultValue=2000", "DefaultValue=many")
    drive = Bench(like=like(path))
    assert drive.drive.config.like.notes == (f"{path}: [6065] DefaultValue=many is left out",)
    assert drive.read(0x6065) == 2000  # a turn of the motor, as the machine has it


def test_positions_count_in_the_angle_of_60a8(tmp_path):
    degrees = Bench(
        like=like(changed(tmp_path, "DefaultValue=0x00B50000", "DefaultValue=0xFE410000"))
    )
    assert degrees.axis.units.per_revolution == pytest.approx(36_000.0)
    assert degrees.axis.units.velocity == pytest.approx(60.0 / 36_000.0)  # rpm


def test_accelerations_count_as_60aa_says(tmp_path):
    rpm = bench("rpm_servo.eds").axis.units
    assert rpm.acceleration == rpm.velocity == pytest.approx(60.0 / 2000.0)
    counts = like(changed(tmp_path, "DefaultValue=0x00C00300", "DefaultValue=0x00B55700"))
    assert Bench(like=counts).axis.units.acceleration == 1.0
    assert Bench(like=like(without(tmp_path, "60AA"))).axis.units.acceleration == pytest.approx(
        0.03
    )


def test_a_maxon_counts_its_rated_torque_in_millionths(tmp_path):
    path = changed(tmp_path, "DefaultValue=0x1F11", "DefaultValue=0xFB")
    (drive,) = drive_configs(SimConfig(nodes=1, from_eds=path)).values()
    assert drive.personality.torque_unit == 1e-6
    (other,) = drive_configs(SimConfig(nodes=1, from_eds=str(SHEETS / "rpm_servo.eds"))).values()
    assert other.personality.torque_unit == 1e-3


def test_values_that_the_file_allows_are_taken(tmp_path):
    """A file without limits allows what the type holds; the machine works with what it can."""
    servo = Bench(like=like(without_limits(tmp_path)))
    rows = (
        (0x60C2, 1, 0, "B"), (0x60C2, 2, 3, "b"), (0x605A, 0, -1, "h"), (0x605C, 0, 7, "h"),
        (0x6083, 0, 0, "I"), (0x6085, 0, 0, "I"), (0x6098, 0, 0, "b"), (0x6099, 1, 0, "I"),
        (0x6091, 2, 0, "I"),
    )  # fmt: skip
    for index, sub, value, layout in rows:
        servo.write(index, sub, value, layout)
        assert servo.read(index, sub, layout) == value
    servo.enable(PP)
    servo.write(0x607A, 0, 4000, "i")
    servo.control(0x1F)
    servo.run(1.0)
    assert servo.axis.motor.revolutions == pytest.approx(2.0, abs=0.01)
    servo.control(0x0B)  # quick stop, by a ramp of the machine's own
    servo.run(0.5)
    assert not servo.axis.powered


def without_limits(tmp_path):
    path = tmp_path / "free.eds"
    lines = (SHEETS / "rpm_servo.eds").read_text().splitlines()
    path.write_text("\n".join(li for li in lines if not li.startswith(("LowLimit", "HighLimit"))))
    return str(path)


def test_a_period_of_0_is_that_of_sync(tmp_path):
    servo = Bench(like=like(without_limits(tmp_path)))
    servo.write(0x60C2, 1, 0, "B")
    servo.frame(0, bytes((1, NODE)))
    for _ in range(3):
        servo.now += 0.02
        servo.frame(0x80)
    assert servo.axis.period == pytest.approx(0.02)


def test_a_homing_method_that_it_has_not_fails(tmp_path):
    servo = Bench(like=like(without_limits(tmp_path)))
    servo.write(0x6098, 0, 0, "b")
    servo.enable(HM)
    servo.control(0x1F)
    servo.run(0.1)
    assert servo.statusword & 0x3000 == 0x2000
