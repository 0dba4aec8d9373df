"""Tool definitions: read, refused, and cut for their way to the tracker."""

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ndi.rom import CHUNK, SIZE, parse_rom, read_rom
from crtk_drivers.errors import ConfigError
from crtk_sim_backends.ndi.handles import make_rom

ROM = make_rom("8700340", kind=2, manufacturer="NDI")


def test_what_a_definition_says() -> None:
    rom = parse_rom(ROM + bytes(272))
    assert (rom.part_number, rom.manufacturer, rom.kind) == ("8700340", "NDI", 2)
    assert rom.markers[2] == (35.0, 75.0, 0.0)
    assert (len(rom.markers), rom.least_markers, rom.largest_error, rom.largest_angle) == (
        4,
        3,
        2.0,
        90,
    )


def test_it_goes_to_the_tracker_in_whole_pieces() -> None:
    chunks = parse_rom(ROM).chunks
    assert [address for address, _ in chunks] == list(range(0, SIZE, CHUNK))
    assert {len(data) for _, data in chunks} == {CHUNK}
    assert b"".join(data for _, data in chunks) == ROM + bytes(16)


@given(st.integers(6, SIZE - 1), st.integers(1, 255))
def test_a_changed_byte_is_found(at: int, change: int) -> None:
    damaged = bytearray(ROM)
    damaged[at] ^= change
    with pytest.raises(ValueError, match="damaged"):
        parse_rom(bytes(damaged))


@pytest.mark.parametrize("data", [b"", b"NDI\0", ROM[:-1], b"IDN\0" + ROM[4:], bytes(SIZE)])
def test_what_is_none_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="no tool definition"):
        parse_rom(data)


@pytest.mark.parametrize("count", [0, 21, 255])
def test_an_impossible_number_of_markers_is_refused(count: int) -> None:
    data = bytearray(ROM)
    data[28] = count
    struct.pack_into("<H", data, 4, sum(data[6:]) & 0xFFFF)
    with pytest.raises(ValueError, match=f"{count} markers"):
        parse_rom(bytes(data))


@given(st.binary(max_size=1100))
def test_hostile_files_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"definition|damaged|markers"):
        parse_rom(data)


def test_an_error_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "pointer.rom"
    with pytest.raises(ConfigError, match=r"pointer\.rom"):
        read_rom(path)
    path.write_bytes(b"NDI\0")
    with pytest.raises(ConfigError, match=r"pointer\.rom.*came with the tool"):
        read_rom(path)
    path.write_bytes(bytes(2000))
    with pytest.raises(ConfigError, match="2000 bytes"):
        read_rom(path)
