"""EDS and DCF files: those of the field load, the others are refused with file and line."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from canopen.objectdictionary.eds import import_eds
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen import eds
from crtk_driver_canopen.emcy import Emergency, decode, error_text, register_text
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType
from crtk_drivers.errors import ConfigError

GOOD = """\
[FileInfo]
FileName=drive.eds
[DeviceInfo]
VendorName=Somebody
VendorNumber=0x1234
BaudRate_1000=1
[DummyUsage]
Dummy0001=0
Dummy0002=1
Dummy0003=0
Dummy0004=0
Dummy0005=1
Dummy0006=0
Dummy0007=0
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2
[1018sub0]
ParameterName=Highest sub-index
DataType=0x0005
AccessType=ro
DefaultValue=1
[1018sub1]
ParameterName=Vendor-ID
DataType=0x0007
AccessType=ro
[1400]
ParameterName=RPDO
ObjectType=0x9
SubNumber=2
[1400sub0]
ParameterName=Count
DataType=0x0005
AccessType=const
[1400sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x200
[607A]
ParameterName=Target position
ObjectType=0x7
DataType=0x0004
AccessType=rww
LowLimit=-5
HighLimit=0x7FFFFFFF
PDOMapping=1
"""


def sheet(tmp_path: Path, text: str, node: int | None = 3) -> eds.DataSheet:
    path = tmp_path / "drive.eds"
    path.write_bytes(text.encode("utf-8"))
    return eds.load(path, node)


def test_a_good_file_is_read_as_it_is(tmp_path: Path) -> None:
    found = sheet(tmp_path, GOOD)
    assert found.repairs == ()
    assert found.entry(0x607A, 0) == Entry(0x607A, 0, ObjectType.I32, "Target position")
    assert found.entry(0x1018, 1) == Entry(0x1018, 1, ObjectType.U32, "Identity Vendor-ID")
    assert found.entry(0x1018, 2) is None
    assert found.dictionary[0x1400][1].default == 0x203
    assert found.dictionary[0x607A].min == -5
    assert found.values() == []


# What the canopen library raises on, or what it silently loses; each is met in files of the field.
TROUBLE = {
    "dummies left out": (GOOD.replace("Dummy0002=1\n", ""), "Dummy0002 is not 0 or 1"),
    "empty device info": (
        GOOD.replace("BaudRate_1000=1", "BaudRate_1000=\nNrOfRXPDO=\nLSS_Supported="),
        "NrOfRXPDO= is no number",
    ),
    "empty vendor number": (GOOD.replace("=0x1234", "="), "VendorNumber= is no number"),
    "a section twice": (GOOD + "[1000]\nParameterName=Device type\n", "[1000] is there twice"),
    "a key twice": (GOOD.replace("SubNumber=2\n", "SubNumber=2\nSubNumber=2\n"), ""),
    "a line without a key": (GOOD + "what is this\n", "'what is this' is no key"),
    "no data type": (GOOD.replace("DataType=0x0004\n", ""), "[607A] has no DataType"),
    "no access type": (GOOD.replace("AccessType=rww\n", ""), "[607A] has no AccessType"),
    "no name": (GOOD.replace("ParameterName=Target position\n", ""), "[607A] has no ParameterName"),
    "empty PDO mapping": (GOOD.replace("PDOMapping=1", "PDOMapping="), "PDOMapping= is no number"),
    "a part without its object": (
        GOOD.replace("[1400]\nParameterName=RPDO\nObjectType=0x9\nSubNumber=2\n", ""),
        "[1400] is missing",
    ),
    "a part before its object": (
        "[2000sub0]\nParameterName=n\nDataType=5\nAccessType=ro\n"
        + GOOD
        + "[2000]\nParameterName=Things\nObjectType=9\n",
        "",
    ),
    "no object type": (GOOD.replace("ObjectType=0x9", "ObjectType="), "ObjectType= is unknown"),
    "comments without lines": (GOOD + "[Comments]\nLine1=x\n", ""),
    "commissioning": (GOOD + "[DeviceComissioning]\nBaudrate=0x1F4\nNodeID=\n", "NodeID= is no"),
    "names of nothing": (GOOD + "[607AName]\nNrOfEntries=3\n", "[607AName] names nothing"),
    "names left out": (
        GOOD
        + "[2100]\nParameterName=Slots\nObjectType=8\nDataType=5\nAccessType=rw\nCompactSubObj=3\n"
        + "[2100Name]\nNrOfEntries=1\n2=Second\n",
        "",
    ),
}


@pytest.mark.parametrize("name", TROUBLE)
def test_files_that_the_library_trips_over_are_mended(tmp_path: Path, name: str) -> None:
    text, told = TROUBLE[name]
    with pytest.raises(Exception):  # noqa: B017, PT011 - whatever it is: without it there is nothing to mend
        import_eds(io.StringIO(text), 3)
    found = sheet(tmp_path, text)
    assert any(told in repair for repair in found.repairs) if told else True
    assert all(repair.startswith(f"{tmp_path}/drive.eds:") for repair in found.repairs)
    assert found.entry(0x1000, 0) == Entry(0x1000, 0, ObjectType.U32, "Device type")
    assert found.entry(0x607A, 0) is not None
    assert found.dictionary[0x1400][1].default == 0x203


def test_upper_and_lower_case_do_not_matter(tmp_path: Path) -> None:
    upper = "\n".join(
        line if "=" not in line else f"{line.split('=')[0].upper()}={line.split('=', 1)[1]}"
        for line in GOOD.replace("sub", "SUB").replace("[607A]", "[607a]").splitlines()
    )
    found = sheet(tmp_path, upper)
    assert [str(each) for each in map(found.entry, (0x607A, 0x1018), (0, 1))] == [
        "607Ah:00 Target position",
        "1018h:01 Identity Vendor-ID",
    ]


def test_names_of_a_compact_array(tmp_path: Path) -> None:
    found = sheet(tmp_path, TROUBLE["names left out"][0])
    assert [found.entry(0x2100, sub).name for sub in (1, 2, 3)] == [  # type: ignore[union-attr]
        "Slots Slots1",
        "Slots Second",
        "Slots Slots3",
    ]


def test_objects_are_found_by_name_and_number(tmp_path: Path) -> None:
    found = sheet(tmp_path, GOOD)
    for text in ("607A", "0x607a:0", "Target position", "target_position"):
        assert found.find(text).index == 0x607A
    assert found.find("identity vendor-id") == found.entry(0x1018, 1)
    assert found.find("2345:1").type is ObjectType.BYTES
    with pytest.raises(ValueError, match="did you mean 'target_position'"):
        found.find("targt position")


def test_values_of_a_dcf(tmp_path: Path) -> None:
    dcf = GOOD.replace("DefaultValue=$NODEID+0x200", "ParameterValue=$NODEID+0x80000200")
    assert sheet(tmp_path, dcf.replace("PDOMapping=1", "ParameterValue=-7")).values() == [
        (Entry(0x1400, 1, ObjectType.U32, "RPDO COB-ID"), 0x80000203),
        (Entry(0x607A, 0, ObjectType.I32, "Target position"), -7),
    ]


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "has no objects"),
        (b"<?xml version='1.0'?><a>[b]</a>", "XDD file must be converted"),
        (b"[1000]\nParameterName=a\0b\n", "drive.eds:2: is not text"),
        (b"\n" * (eds.MAX_SIZE + 1), "an EDS file has at most"),
    ],
)
def test_what_is_no_eds_is_refused(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "drive.eds"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=text):
        eds.load(path)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        eds.load(tmp_path / "none.eds")
    with pytest.raises(ConfigError, match="is a directory"):
        eds.load(tmp_path)


LINES = GOOD.splitlines()


@given(st.sets(st.integers(0, len(LINES) - 1)), st.integers(0, len(GOOD)))
def test_whatever_is_left_out_it_loads_or_is_refused(without: set[int], length: int) -> None:
    kept = [line for number, line in enumerate(LINES) if number not in without]
    text = "\n".join(kept)[:length]
    try:
        mended, _ = eds.repair(text, "drive.eds")
    except ConfigError as error:
        assert "no objects" in str(error)  # noqa: PT017 - either way is right
        return
    assert import_eds(io.StringIO(mended), 3) is not None


def test_a_file_of_many_objects() -> None:
    """It took minutes when each object looked through all sections."""
    numbers = range(0x2000, 0x2000 + 40_000)
    text = "".join(f"[{number:04X}]\nParameterName=p\nDataType=7\n" for number in numbers)
    sections, _ = eds.repair(text, "many.eds")
    assert sections.count("[") == 40_001


def test_the_published_eds_of_the_simulated_drives() -> None:
    import crtk_sim_backends.canopen

    path = Path(crtk_sim_backends.canopen.__file__).parent / "drive.eds"
    found = eds.load(path, 1)
    assert found.repairs == ()
    for name in ("statusword", "target_position", "mode_of_operation", "producer_heartbeat_time"):
        standard = OBJECTS[name]
        entry = found.entry(standard.index, standard.sub)
        assert entry is not None
        assert entry.type is standard.type


# Emergency messages


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x0000, "no error"),
        (0x1000, "generic error"),
        (0x3210, "DC link over-voltage"),
        (0x8611, "following error"),
        (0x7121, "motor blocked"),
        (0x8130, "heartbeat or life guarding of another node lost"),
        (0x3215, "DC link over-voltage"),  # its class
        (0x42FF, "device temperature"),
        (0xFF12, "of the manufacturer"),
        (0xB000, "unknown error"),
        (0x0012, "unknown error"),
    ],
)
def test_error_codes_in_words(code: int, text: str) -> None:
    assert error_text(code) == text


def test_an_emergency_in_words() -> None:
    message = decode(4, bytes.fromhex("1186 21 0102000000".replace(" ", "")))
    assert message == Emergency(4, 0x8611, 0x21, b"\1\2\0\0\0")
    assert str(message) == (
        "node 4: following error (0x8611), error register: generic, device profile, "
        "vendor bytes 01 02 00 00 00"
    )
    assert not message.is_reset
    assert decode(4, b"").is_reset
    assert str(decode(4, bytes(8))) == "node 4: no error (0x0000)"
    assert register_text(0b10011111) == (
        "generic, current, voltage, temperature, communication, manufacturer"
    )


@given(st.binary(max_size=10))
def test_any_emergency_has_words(data: bytes) -> None:
    message = decode(1, data)
    assert len(message.vendor) == 5
    assert str(message).startswith("node 1: ")
