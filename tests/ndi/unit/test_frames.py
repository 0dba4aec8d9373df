"""TX, BX and BX2: replies that are known, cut off, changed, hostile; what they say of the tools."""

import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ndi.codec import Reply
from crtk_driver_ndi.frames import PARSERS, Frame, Stray, parse_bx, parse_bx2, parse_tx
from crtk_drivers.kit import BadData

TX = (
    "0201+10000+00000+00000+00000+001000+002000-100000+01250"
    "0000003100000007\n02MISSING0000003100000007\n0000"
)
BX = bytes.fromhex(
    "0201010000803f000000000000000000000000000020410000a04100007ac40000003e"
    "31000000070000000202310000000700000000 00"
)
BX2 = bytes.fromhex(
    "0100010001005400000000000100000002000000070000000100 0000f40100000100010002003400000000000200"
    "0000010000000000803f000000000000000000000000000020410000a04100007ac40000003e02001f01"
)
VALUES = (1.0, 0.0, 0.0, 0.0, 10.0, 20.0, -1000.0, 0.125)


def component(kind: int, items: int, data: bytes, size: int | None = None) -> bytes:
    return struct.pack("<HIHI", kind, 12 + len(data) if size is None else size, 0, items) + data


def gbf(*components: bytes) -> bytes:
    return struct.pack("<HH", 1, len(components)) + b"".join(components)


def framed(*components: bytes, number: int = 7) -> bytes:
    head = struct.pack("<BBHIII", 2, 0, 0, number, 1, 500)
    return gbf(component(1, 1, head + gbf(*components)))


@pytest.mark.parametrize(
    ("parse", "reply"),
    [(parse_tx, Reply(TX)), (parse_bx, Reply(body=BX)), (parse_bx2, Reply(body=BX2))],
)
def test_one_tool_and_one_that_is_missing(parse: Callable[[Reply], Frame], reply: Reply) -> None:
    frame = parse(reply)
    assert list(frame.tools) == [1, 2]
    assert frame.tools[1].values == pytest.approx(VALUES)
    assert frame.tools[1].told == ()
    assert frame.tools[2].values is None
    assert frame.tools[2].told == ("missing",)
    assert frame.number == 7
    assert frame.system == 0


def test_only_bx2_tells_the_time() -> None:
    assert parse_bx2(Reply(body=BX2)).nanoseconds == 1_000_000_500
    assert parse_bx(Reply(body=BX)).nanoseconds == 0


def test_the_port_status_says_what_a_pose_suffers_from_and_which_button_is_pressed() -> None:
    status = 0x31 | 1 << 2 | 1 << 7 | 1 << 9
    text = TX.replace("01250" + "00000031", f"01250{status:08X}")
    tool = parse_tx(Reply(text)).tools[1]
    assert tool.told == ("partly out of volume", "infrared interference")
    assert tool.buttons == (False, True, False)


def test_disabled_and_unplugged_tools_say_nothing_else() -> None:
    frame = parse_tx(Reply("0301DISABLED\n02UNOCCUPIED\n03MISSING0000003100000009\n0080"))
    assert [tool.told for tool in frame.tools.values()] == [
        ("disabled",),
        ("unoccupied",),
        ("missing",),
    ]
    assert frame.number == 9
    assert frame.system == 0x80
    assert parse_bx(Reply(body=b"\x01\x05\x04\x00\x00")).tools[5].told == ("disabled",)


def test_what_an_aurora_says_behind_the_frame_is_left_alone() -> None:
    text = TX.replace("00000007\n02", "00000007extra\n02")
    assert parse_tx(Reply(text)).tools[1].values == pytest.approx(VALUES)


def test_stray_markers() -> None:
    tail = "02" + "2" + "+001000+002000-100000" * 2 + "0000"
    frame = parse_tx(Reply("00" + "\n" + tail))
    assert frame.strays == [Stray(10.0, 20.0, -1000.0, False), Stray(10.0, 20.0, -1000.0, True)]
    point = struct.pack("<3f", 10.0, 20.0, -1000.0)
    bx = parse_bx(Reply(body=b"\0\x02\x02" + 2 * point + b"\0\0"), strays=True)
    assert bx.strays == frame.strays
    markers = (
        struct.pack("<HH", 0xFFFF, 3) + b"\0\0\0\0" + point + b"\4\0\1\0" + point + b"\1\0\2\0"
    )
    assert parse_bx2(Reply(body=framed(component(3, 1, markers)))).strays == frame.strays


def test_buttons_alerts_and_unknown_components() -> None:
    tool = struct.pack("<HH", 1, 0x11F)
    pressed = struct.pack("<HH3B", 1, 3, 1, 0, 1)
    alert = struct.pack("<BBH", 4, 0, 1)
    body = framed(
        component(0x77, 5, b"whatever"),
        component(2, 1, tool),
        component(4, 1, pressed),
        component(0x12, 1, alert),
    )
    frame = parse_bx2(Reply(body=body))
    assert frame.tools[1].buttons == (True, False, True)
    assert frame.tools[1].told == ("missing",)
    assert frame.tools[1].number == 7
    assert frame.alerts == [(4, 1)]


@pytest.mark.parametrize(
    "body", [gbf(), framed(), framed(component(2, 0, b"")), gbf(component(1, 0, b""))]
)
def test_a_reply_without_tools_is_no_new_frame(body: bytes) -> None:
    assert parse_bx2(Reply(body=body)).number == -1


@pytest.mark.parametrize(
    "body",
    [
        framed(component(2, 1, b"\1\0\0\0")),  # a tool that ends too early
        framed(component(2, 0xFFFFFFFF, b"\1\0\x1f\1")),
        framed(component(3, 1, struct.pack("<HH", 1, 0xFFFF))),
        framed(component(4, 1, struct.pack("<HH", 1, 0xFFFF))),
        gbf(component(1, 1, b"", size=0)),
        gbf(component(1, 1, b"", size=0xFFFFFFFF)),
        struct.pack("<HH", 1, 0xFFFF),
        b"",
    ],
)
def test_what_is_longer_than_its_container_is_refused(body: bytes) -> None:
    with pytest.raises(BadData):
        parse_bx2(Reply(body=body))


@pytest.mark.parametrize("kind", ["BX", "BX2"])
def test_cut_off_anywhere_it_is_refused(kind: str) -> None:
    whole = {"BX": BX, "BX2": BX2}[kind]
    for end in range(len(whole)):
        with pytest.raises(BadData):
            PARSERS[kind][1](Reply(body=whole[:end]))


def test_what_follows_a_bx_reply_is_refused() -> None:
    with pytest.raises(BadData, match="behind the end"):
        parse_bx(Reply(body=BX + b"\0"))


@given(st.sampled_from(sorted(PARSERS)), st.binary(max_size=200), st.text(max_size=200))
def test_hostile_replies_are_refused_with_a_value_error(kind: str, body: bytes, text: str) -> None:
    try:
        frame = PARSERS[kind][1](Reply(text, body))
    except ValueError:
        return
    assert len(frame.tools) <= 255


@given(st.data())
def test_changed_replies_are_refused_or_read_within_their_bounds(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(["BX", "BX2"]))
    body = bytearray({"BX": BX, "BX2": BX2}[kind])
    for _ in range(data.draw(st.integers(1, 6))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    try:
        frame = PARSERS[kind][1](Reply(body=bytes(body)))
    except ValueError:
        return
    assert len(frame.tools) <= 4
