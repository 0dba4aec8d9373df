"""The simulated tracker without a driver: known bytes, modes, errors, handles."""

import struct
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.faults import Fault, check_fault
from crtk_sim_backends.ndi import CommandSession, frames, wire
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.ndi.families import FAMILIES
from crtk_sim_backends.ndi.frames import Seen
from crtk_sim_backends.ndi.handles import make_rom
from crtk_sim_backends.ndi.injection import KINDS
from crtk_sim_backends.ndi.motion import MOTIONS, Place
from crtk_sim_backends.ndi.plugs import sensors_of
from crtk_sim_backends.ndi.tracker import Tracker

SEEN = [
    Seen(1, Place(10.0, 20.0, -1000.0, 1.0, 0.0, 0.0, 0.0, 0.125), 0, 0x31, enabled=True),
    Seen(2, None, 0, 0x31, enabled=True),
]


def never(seconds: float, session: CommandSession, reply: Callable[[], bytes]) -> None:
    """Send nothing later: no test of this file has a reply that is late."""
    raise AssertionError(f"a reply is {seconds} s late")


class Lab:
    """A tracker at a time that a test chooses."""

    def __init__(
        self, family: str = "vega", wired: Sequence[str] = ("A", "REF"), left: int = 0
    ) -> None:
        self.now = 100.0
        self.tracker = Tracker(
            FAMILIES[family],
            sensors_of(",".join(wired)),
            MOTIONS["circle"],
            0.0,
            left,
            TrackerDefects(),
            lambda: self.now,
            lambda: round(self.now * 1e9),
        )

    def ask(self, text: str) -> str:
        data = text.encode()
        reply = self.tracker.obey(data + b"%04X" % wire.check(data))
        assert reply.endswith(b"\r")
        return reply[:-5].decode()

    def binary(self, text: str) -> bytes:
        data = text.encode()
        return self.tracker.obey(data + b"%04X" % wire.check(data))

    def ready(self) -> None:
        """Two wired tools are tracked."""
        for text in (
            "INIT:",
            "PHSR:02",
            "PINIT:01",
            "PHSR:02",
            "PINIT:02",
            "PENA:01D",
            "PENA:02S",
            "TSTART:80",
        ):
            assert not self.ask(text).startswith("ERROR"), text

    def begin(self, kind: str, **parameters: object) -> Fault:
        fault = check_fault(KINDS, kind, parameters, "test")
        self.tracker.begin(fault)
        return fault


@pytest.mark.parametrize(
    ("text", "check"),
    [
        ("INIT:", "E3A5"),
        ("TX:0801", "C19B"),
        ("PENA:01D", "6D3B"),
        ("OKAY", "A896"),
        ("WARNING06", "018D"),
    ],
)
def test_known_checks(text: str, check: str) -> None:
    assert f"{wire.check(text.encode()):04X}" == check


def test_the_known_tx_reply() -> None:
    text = frames.tx(SEEN, 7, 0, 0x0801)
    assert text == (
        "0201+10000+00000+00000+00000+001000+002000-100000+01250"
        "0000003100000007\n02MISSING0000003100000007\n0000"
    )
    assert wire.words(text).endswith(b"B152\r")


def test_the_known_bx_reply() -> None:
    assert wire.binary(frames.bx(SEEN, 7, 0, 0x0801)).hex() == (
        "c4a537003b2302010100" "00803f000000000000000000000000000020410000a04100007ac40000003e"
        "31000000070000000202310000000700000000" "0069c5"
    )  # fmt: skip


def test_a_bx2_reply_has_the_known_layout() -> None:
    body = frames.bx2(SEEN, 7, 1_000_000_500, magnetic=False)
    known = bytes.fromhex("02003400000000000200000001000000" "0000803f")  # fmt: skip
    assert known in body
    assert bytes.fromhex("02001f01") in body
    assert body.startswith(bytes.fromhex("010001000100"))
    assert bytes.fromhex("0200000007000000" "01000000f4010000") in body  # fmt: skip


def test_commands_are_refused_in_the_wrong_mode() -> None:
    lab = Lab()
    assert lab.ask("PHSR:00") == "ERROR10"
    assert lab.ask("BX:0001") == "ERROR10"
    assert lab.ask("INIT:") == "OKAY"
    assert lab.ask("BX:0001") == "ERROR0C"
    lab.ready()
    assert lab.ask("PINIT:01") == "ERROR0C"
    assert lab.ask("TSTOP:") == "OKAY"
    assert lab.ask("TSTOP:") == "ERROR0C"


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("WHAT:", "01"),
        ("PHSR:09", "07"),
        ("PHF:20", "08"),
        ("PENA:01D", "0E"),
        ("PENA:0AD", "08"),
        ("PVWR:01" + "0000" + "00" * 63, "07"),
        ("PVWR:01" + "03F0" + "00" * 64, "23"),
        ("COMM:80000", "06"),
        ("VSEL:9", "24"),
        ("VER:9", "07"),
        ("GET:nothing", "34"),
        ("PINIT:0A", "08"),
    ],
)
def test_errors(text: str, error: str) -> None:
    lab = Lab()
    lab.ask("INIT:")
    lab.ask("PHSR:00")
    assert lab.ask(text) == f"ERROR{error}"


def test_a_wrong_check_is_an_error_and_a_blank_needs_none() -> None:
    lab = Lab()
    assert lab.tracker.obey(b"INIT:0000") == wire.error(0x04)
    assert lab.tracker.obey(b"INIT ") == wire.words("OKAY")
    assert lab.tracker.obey(b"VER 9") == wire.error(0x07)
    assert Lab("aurora").tracker.obey(b"VER 9") == wire.error(0x23)


def test_a_definition_is_checked_when_it_is_initialised() -> None:
    lab = Lab(wired=())
    lab.ask("INIT:")
    assert lab.ask("PHRQ:*********1****") == "01"
    assert lab.ask("PINIT:01") == "ERROR2C"
    rom = bytearray(make_rom("8700340").ljust(768, b"\0"))
    rom[100] ^= 1
    for good in (False, True):
        rom[100] ^= good
        for at in range(0, 768, 64):
            assert lab.ask(f"PVWR:01{at:04X}{rom[at : at + 64].hex()}") == "OKAY"
        assert lab.ask("PINIT:01") == ("OKAY" if good else "ERROR40")
    assert lab.ask("PHINF:010004") == f"{'8700340':<20}"
    assert lab.ask("PHINF:010001") == f"02000000{'CRTK SIM':<12}000{'':<8}11"


def test_what_a_dead_client_has_left_must_be_freed() -> None:
    lab = Lab(left=1)
    assert lab.ask("INIT:") == "OKAY"
    assert lab.ask("PINIT:01") == "ERROR13"
    assert lab.ask("PHF:01") == "OKAY"
    assert lab.ask("PHSR:02")[:4] == "0202"
    assert lab.ask("PINIT:01") == "OKAY"


def test_an_aurora_shows_its_tools_one_after_the_other() -> None:
    lab = Lab("aurora")
    lab.ask("INIT:")
    assert lab.ask("PHSR:02") == "0101001"
    lab.ask("PINIT:01")
    assert lab.ask("PHSR:02") == "0102001"


def test_frames_follow_the_clock_and_bx2_tells_each_once() -> None:
    lab = Lab()
    lab.ready()
    for seconds, number in ((0.0, 0), (0.5, 30), (1.0, 60)):
        lab.now = 100.0 + seconds + 1e-6
        assert struct.unpack_from("<I", lab.binary("BX:0001"), 6 + 1 + 2 + 32 + 4)[0] == number
        assert len(lab.binary("BX2:")) > 100
        assert len(lab.binary("BX2:")) == 6 + 4 + 2


def test_old_families_have_no_bx2_and_an_aurora_sends_long_ones() -> None:
    old = Lab("spectra")
    old.ready()
    assert old.ask("BX2:") == "ERROR01"
    aurora = Lab("aurora")
    aurora.ready()
    assert aurora.binary("BX2:").startswith(b"\xc8\xa5")
    assert aurora.binary("BX:0001").startswith(b"\xc4\xa5")


def test_what_is_out_of_the_volume_is_missing_unless_asked_for() -> None:
    lab = Lab()
    lab.ready()
    lab.begin("hide", tool=0, how="out")
    assert "01MISSING" in lab.ask("TX:0001")
    assert "01MISSING" not in lab.ask("TX:0801")


def test_every_error_can_be_had() -> None:
    for code in range(1, 256):
        lab = Lab()
        fault = lab.begin("error", command="INIT", code=code)
        assert lab.ask("INIT:") == f"ERROR{code:02X}"
        lab.tracker.end(fault)
        assert lab.ask("INIT:") == "OKAY", code


@given(st.binary(max_size=200))
def test_hostile_commands_are_answered_with_errors(data: bytes) -> None:
    session = CommandSession(Lab().tracker, lambda: True, never)
    for reply in session.receive(data + b"\r").split(b"\r")[:-1]:
        assert reply.startswith(b"ERROR") or data


def test_a_command_that_never_ends_is_too_long() -> None:
    session = CommandSession(Lab().tracker, lambda: True, never)
    assert session.receive(b"A" * 3000) == wire.error(0x02)


def test_at_another_rate_nothing_is_understood() -> None:
    rates = [False, True]
    session = CommandSession(Lab().tracker, lambda: rates[0], never)
    assert session.receive(b"INIT \r") == b""
    rates[0] = True
    assert session.receive(b"INIT \r") == wire.words("OKAY")
