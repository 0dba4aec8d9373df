"""The published EDS against the dictionary of the simulated drive, by way of an independent reader."""

import canopen
import pytest

from crtk_sim_backends.canopen.dictionary import Kind, OfNode
from crtk_sim_backends.canopen.drive import Drive, DriveConfig, drive_objects, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.personality import PERSONALITIES
from crtk_sim_backends.canopen.plant import MotorConfig

NODE = 11


@pytest.fixture(scope="module")
def sheet():
    return canopen.import_od(str(PUBLISHED), NODE)


def variables(sheet, index, entry):
    """Entries of an object as the canopen library has read them."""
    if entry.kind in (Kind.VAR, Kind.DOMAIN):
        return {0: sheet[index]}
    return dict(sheet[index].subindices)


def test_published_sheet_is_the_one_of_the_dictionary():
    assert PUBLISHED.read_text() == eds_of(DriveConfig()), (
        "the objects have changed: write drive.eds anew with "
        "`python -m crtk_sim_backends.canopen --eds FILE`"
    )


def test_every_object_is_there_with_type_access_default_and_limits(sheet):
    objects, _ = drive_objects(DriveConfig(serial=0), NODE)
    assert set(sheet.indices) - set(range(1, 8)) == {entry.index for entry in objects}
    for entry in objects:
        read = variables(sheet, entry.index, entry)
        assert set(read) == set(entry.entries)
        for sub, variable in entry.entries.items():
            theirs = read[sub]
            where = f"{entry.index:04X}:{sub}"
            assert theirs.data_type == variable.type.number, where
            assert theirs.access_type == variable.access, where
            assert theirs.pdo_mappable == bool(variable.pdo), where
            default = variable.default
            if isinstance(default, OfNode):
                default = NODE + default.offset
            if isinstance(default, bytes):
                default = default.decode()
            if variable.type.size or default:
                assert theirs.default == default, where
            assert theirs.min == variable.low, where
            assert theirs.max == variable.high, where


def test_defaults_of_the_sheet_are_what_the_drive_answers(sheet):
    drive = Drive(NODE)
    for index in sheet.indices:
        if index < 0x1000:
            continue
        entries = variables(sheet, index, drive.dictionary.objects[index])
        for sub, variable in entries.items():
            if (index, sub) in drive.dictionary.live or variable.access_type == "wo":
                continue
            data = drive.dictionary.read(index, sub)
            if (index, sub) == (0x1018, 4):
                assert variable.decode_raw(data) == NODE  # each drive has its own number
            elif variable.default is not None:
                assert variable.decode_raw(data) == variable.default, f"{index:04X}:{sub}"


@pytest.mark.parametrize(("make", "axes"), [("standard", 2), ("careful", 1), ("plain", 3)])
def test_sheets_of_other_drives_can_be_read(tmp_path, make, axes):
    config = DriveConfig(motors=(MotorConfig(),) * axes, personality=PERSONALITIES[make])
    path = tmp_path / "other.eds"
    path.write_text(eds_of(config))
    other = canopen.import_od(str(path), NODE)
    assert other[0x1018][1].default == PERSONALITIES[make].vendor
    assert (0x6040 + 0x800 * (axes - 1)) in other
    assert other.device_information.product_name == PERSONALITIES[make].device
