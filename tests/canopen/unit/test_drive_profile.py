"""Drive profiles: tables of what a make does otherwise, and the first one of an EDS."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen import eds, emcy, tools
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.drive_profile import (
    PLAIN,
    DriveProfile,
    built_in,
    kin,
    named,
    of_identity,
)
from crtk_driver_canopen.eds_profile import first_profile, hidden_modes, oddities
from crtk_driver_canopen.identity import Identity
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.standard import ROWS, Row
from crtk_driver_canopen.tools import ProfileOptions
from crtk_drivers.config import from_file, from_values, load
from crtk_drivers.errors import ConfigError
from crtk_sim_backends.canopen.drive import DriveConfig, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.personality import PERSONALITIES

SHEETS = Path(__file__).parents[2] / "data" / "eds"
EPOS4 = Identity(vendor=0xFB, product=0x60500000)
JOINT = {"node": 1, "lower": -1.0, "upper": 1.0, "velocity": 1.0}


def epos4_sheet(tmp_path: Path) -> eds.DataSheet:
    path = tmp_path / "epos4.eds"
    path.write_text(eds_of(DriveConfig(personality=PERSONALITIES["epos4"])))
    return eds.load(path, 1)


@pytest.mark.parametrize(
    ("identity", "name"),
    [
        (EPOS4, "Maxon EPOS4"),
        (Identity(vendor=0xFB, product=0x60500123), "Maxon EPOS4"),
        (Identity(vendor=0xFB, product=0x61200000), PLAIN.name),  # another product of theirs
        (Identity(vendor=0xFC, product=0x60500000), PLAIN.name),
        (Identity(vendor=0xFB), PLAIN.name),
        (Identity(), PLAIN.name),
    ],
)
def test_a_profile_is_found_by_vendor_and_product(identity: Identity, name: str) -> None:
    assert of_identity(identity).name == name


def test_another_product_of_the_same_maker_has_kin() -> None:
    assert kin(Identity(vendor=0xFB, product=0x61200000)) == "epos4"
    assert not kin(Identity(vendor=0x1F01))


@pytest.mark.parametrize(
    ("code", "text", "home_lost"),
    [
        (0x1080, "generic initialization error", False),
        (0x1083, "generic initialization error", False),  # not the first of its range
        (0x8A88, "safe torque off is active", False),
        (0x7380, "position sensor breach", True),
        (0x7390, "a position sensor is missing", False),
        (0xFF02, "watchdog of the firmware", True),
        (0x1084, "", False),
    ],
)
def test_error_codes_of_epos4_are_told_by_ranges(code: int, text: str, home_lost: bool) -> None:
    data = code.to_bytes(2, "little") + bytes(6)
    told = emcy.decode(3, data, built_in()["epos4"])
    assert (told.text, told.home_lost) == (text, home_lost)
    assert text in str(told)


def test_without_a_profile_the_same_code_is_that_of_its_class() -> None:
    told = emcy.decode(3, bytes.fromhex("88 8a 01 00 00 00 00 00"))
    assert "control monitoring" in str(told)


@given(st.binary(max_size=12))
def test_no_emergency_message_breaks_it(data: bytes) -> None:
    for profile in (PLAIN, built_in()["epos4"]):
        assert str(emcy.decode(1, data, profile)).startswith("node 1: ")


def test_no_two_rows_of_a_profile_hold_one_code() -> None:
    for profile in built_in().values():
        taken: dict[int, str] = {}
        for row in profile.errors:
            first, _, last = row.codes.partition("-")
            for code in range(int(first, 16), int(last or first, 16) + 1):
                assert code not in taken, hex(code)
                taken[code] = row.text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("modus = ['csp']", "modus"),
        ("modes = ['cps']", "modes"),
        ("errors = [{codes = '73', text = 'x'}]", "no code or range"),
        ("errors = [{codes = '7390-7380', text = 'x'}]", "no code or range"),
        ("home_position = {object = '30G0'}", "is no object"),
        ("rated_torque_unit = 0.0", "rated_torque_unit"),
        ("rated_torque_unit = nan", "rated_torque_unit"),
        ("velocity_unit = -1", "velocity_unit"),
    ],
)
def test_a_wrong_profile_is_refused_with_file_and_line(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f"# a profile\n{text}\n")
    with pytest.raises(ConfigError, match=message) as refusal:
        named(str(path))
    assert f"{path}:2" in str(refusal.value)


def test_a_name_that_is_none_is_refused_before_anything_is_opened() -> None:
    with pytest.raises(
        ConfigError, match=r"no drive profile 'epos5', but auto, none, ax2000, epos4, kinco"
    ):
        load(JointConfig, from_values({**JOINT, "profile": "epos5"}))
    assert load(JointConfig, from_values({**JOINT, "profile": "epos4"})).profile == "epos4"
    assert named("none") is PLAIN
    assert named("auto") is None


def test_what_is_odd_about_an_epos4_is_told(tmp_path: Path) -> None:
    told = "\n".join(oddities(epos4_sheet(tmp_path)))
    for each in (
        "no 607Ch:00 home offset",
        "no 605Dh:00 halt option",
        "no 608Fh:01 encoder increments",
        "no 1029h:01 error behaviour",
        "velocities are turns a minute (60A9h is 0x00b44700)",
        "TPDO 2 is off from the factory",
        "TPDO 1 has no remote request",
        "TPDO 1 has an inhibit time of 1 ms",
        "RPDOs have no deadline",
        "a quick stop (605Ah is 6) stays",
        "homing method (6098h) is 7",
        "its position limits (607Dh) are both 0",
        "taken by itself: epos4",
    ):
        assert each in told, each
    assert "fixed" not in told
    assert "PDO 4, not" not in told


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_each_object_of_the_table_is_missed(tmp_path: Path, row: Row) -> None:
    """A row that nobody asks for would say nothing; a category counts where a drive is refused."""
    path = tmp_path / "drive.eds"
    name = f"{row.entry.index:04X}"
    parts = PUBLISHED.read_text().split("\n\n")
    kept = [part for part in parts if not part.startswith((f"[{name}]", f"[{name}sub"))]
    assert kept != parts
    path.write_text("\n\n".join(kept))
    (told,) = [each for each in oddities(eds.load(path, 1)) if each.startswith(f"no {row.entry}:")]
    assert ("cannot use it" in told) is bool(row.needed & row.used)
    assert row.without in told
    assert row.mandatory <= row.needed


def test_modes_that_6502h_hides_are_told(tmp_path: Path) -> None:
    path = tmp_path / "lies.eds"
    text = (SHEETS / "rpm_servo.eds").read_text()
    path.write_text(text.replace("DefaultValue=0x3A5", "DefaultValue=0x225"))
    sheet = eds.load(path, 1)
    assert path.read_text() != text
    assert hidden_modes(sheet) == (OpMode.CSP, OpMode.CSV)
    assert any("6502h (0x225) does not name csp, csv" in each for each in oddities(sheet))
    assert not hidden_modes(eds.load(SHEETS / "rpm_servo.eds"))


def test_a_drive_of_the_old_dsp_402_is_told(tmp_path: Path) -> None:
    """As a Technosoft iPOS: factors that CiA 402-2 has no more, ip and no cyclic mode."""
    text = (SHEETS / "rpm_servo.eds").read_text()
    assert "which scale what it counts" not in "\n".join(
        oddities(eds.load(SHEETS / "rpm_servo.eds"))
    )
    factor = ["[6093]", "ObjectType=0x8", "SubNumber=2", "ParameterName=Position factor", ""]
    for sub, name in enumerate(("number of entries", "numerator")):
        factor += [f"[6093sub{sub}]", f"ParameterName={name}", "ObjectType=0x7"]
        factor += ["DataType=0x0007", "AccessType=rw", "DefaultValue=1", "PDOMapping=0", ""]
    path = tmp_path / "old.eds"
    old = text.replace("DefaultValue=0x3A5", "DefaultValue=0x1F0065")
    assert old != text
    path.write_text(old + "\n" + "\n".join(factor))
    told = "\n".join(oddities(eds.load(path)))
    assert "factors of the old DSP 402 (6093h)" in told
    assert "does not name csp" in told, "their objects are there"
    path.write_text(re.sub(r"\[60(B0|B1|B2)\]", "[3\\1F]", old))
    assert "0x1f0065) names no cyclic mode" in "\n".join(oddities(eds.load(path)))


def test_fixed_mappings_are_told(tmp_path: Path) -> None:
    parts = (SHEETS / "rpm_servo.eds").read_text().split("\n\n")
    fixed = [
        part.replace("AccessType=rw", "AccessType=ro")
        if part.startswith(("[1602sub", "[1402sub1]"))
        else part
        for part in parts
    ]
    path = tmp_path / "fixed.eds"
    path.write_text("\n\n".join(fixed))
    told = "\n".join(oddities(eds.load(path)))
    assert "the mapping of RPDO 3 is fixed: 6040h:00 controlword, 607Ah:00 target position" in told
    assert "the COB-ID of RPDO 3 is fixed" in told
    assert "RPDO 2 is fixed" not in told


@pytest.mark.parametrize("name", ["rpm_servo", "few_objects", "generic"])
def test_the_first_profile_of_a_file_can_be_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / "first.toml"
    sheet = eds.load(SHEETS / f"{name}.eds")
    odd = oddities(sheet)
    path.write_text(first_profile(sheet, odd))
    profile = load(DriveProfile, from_file(path))
    assert profile.notes == tuple(odd)
    assert profile.identity.vendor in (0x1F11, 0x1F12, 0x1F13)
    assert profile.velocity_unit == (0x00B44700 if name == "rpm_servo" else None)


def test_the_command_writes_a_new_file_and_leaves_an_old_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, path = CanopenConfig(), tmp_path / "servo.toml"
    options = ProfileOptions(eds=str(SHEETS / "rpm_servo.eds"), output=str(path))
    assert tools.profile(config, options) == 0
    assert f"{path} is written" in capsys.readouterr().out
    before = path.read_text()
    assert named(str(path)) == load(DriveProfile, from_file(path))
    for name in (path, tmp_path / "servo.txt", tmp_path / "none" / "servo.toml"):
        with pytest.raises(ConfigError):
            tools.profile(config, options.model_copy(update={"output": str(name)}))
    assert path.read_text() == before
    assert tools.profile(config, options.model_copy(update={"output": ""})) == 0
    assert "velocity_unit = 0x00B44700" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("ProductName", "drive \x7f\x1b" + "x" * 300),
        ("VendorNumber", "0x1FFFFFFFF"),
        ("ProductNumber", "-5"),
        ("DefaultValue", "0x1FFFFFFFF"),
        ("DefaultValue", "-3"),
    ],
)
def test_the_first_profile_of_a_hostile_file_can_be_read(
    tmp_path: Path, key: str, value: str
) -> None:
    keys = {"ProductName": "drive", "VendorNumber": "1", "ProductNumber": "1", "DefaultValue": "1"}
    keys[key] = value
    source, path = tmp_path / "drive.eds", tmp_path / "drive.toml"
    lines = [f"{name}={keys.pop(name)}" for name in list(keys)[:3]]
    source.write_text(
        "\n".join(
            ["[DeviceInfo]", *lines, "[60A9]", "DataType=7", f"DefaultValue={keys.popitem()[1]}"]
        )
    )
    sheet = eds.load(source, 1)
    path.write_text(first_profile(sheet, oddities(sheet)), encoding="utf-8")
    assert load(DriveProfile, from_file(path)).name.startswith("drive")
