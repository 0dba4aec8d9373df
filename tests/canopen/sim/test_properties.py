"""Whatever comes, the simulated drive lives on, sends only legal frames and keeps what it was told."""

import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_sim_backends.canopen.drive import Drive, DriveConfig
from crtk_sim_backends.canopen.machine import State
from crtk_sim_backends.canopen.plant import MotorConfig
from rigs.canopen_drive import Bench
from rigs.examples import examples

NODE = 7
INDICES = sorted(Drive(NODE).dictionary.objects)
SERVER_COMMANDS = {
    0x80,
    *range(0x41, 0x50, 2),
    0x60,
    0x20,
    0x30,
    0xA2,
    0xA1,
    0xA0,
    0xA4,
    0xC2,
    0xC6,
}

index = st.one_of(st.sampled_from(INDICES), st.integers(0, 0xFFFF))
sub = st.one_of(st.integers(0, 8), st.integers(0, 255))
value = st.one_of(
    st.integers(0, 16).map(lambda n: struct.pack("<I", n)), st.binary(min_size=4, max_size=4)
)
sdo = st.builds(
    lambda command, index, sub, data: struct.pack("<BHB", command, index, sub) + data,
    st.one_of(st.sampled_from((0x40, 0x2F, 0x2B, 0x23, 0x21, 0xA4, 0xC6)), st.integers(0, 255)),
    index,
    sub,
    value,
)
mapping = st.builds(
    lambda base, sub, target, bits: struct.pack("<BHBI", 0x23, base, sub, target << 16 | bits),
    st.sampled_from([*range(0x1600, 0x1604), *range(0x1A00, 0x1A04)]),
    st.integers(1, 8),
    st.sampled_from(INDICES),
    st.sampled_from((8, 16, 32)),
)
frame = st.one_of(
    st.tuples(st.just(0x600 + NODE), st.one_of(sdo, mapping, st.binary(max_size=8))),
    st.tuples(
        st.just(0),
        st.builds(lambda c, n: bytes((c, n)), st.sampled_from((1, 2, 0x80, 0x81, 0x82)),
                  st.sampled_from((0, NODE))),
    ),
    st.tuples(st.sampled_from((0x80, 0x200 + NODE, 0x300 + NODE, 0x77F)), st.binary(max_size=8)),
    st.tuples(
        st.just(0x200 + NODE), st.sampled_from((6, 7, 15, 31, 2, 0, 0x80)).map(lambda w: bytes((w, 0)))
    ),
    st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)),
)  # fmt: skip


def check_legal(drive, identifier, data):
    """A frame that a node may send."""
    tpdos = {pdo.identifier: pdo.layout.size for pdo in drive.pdos.transmitting}
    emergency = drive.dictionary[0x1014, 0] & 0x7FF
    if identifier == 0x700 + NODE:
        assert data in (b"\x00", b"\x04", b"\x05", b"\x7f")
    elif identifier in (0x580 + NODE, emergency):
        assert len(data) == 8
    else:
        assert len(data) == tpdos[identifier]


@settings(max_examples=examples(150), deadline=None)
@given(st.lists(st.tuples(frame, st.floats(0, 0.02)), max_size=60), st.sampled_from((1, 2)))
def test_survives_anything(frames, axes):
    drive = Drive(NODE, DriveConfig(motors=(MotorConfig(pendulum=0.1, brake=False),) * axes))
    now = 50.0
    sent = drive.on_timer(now)
    assert sent == [(0x700 + NODE, b"\0")]
    for (identifier, data), pause in frames:
        block = drive._sdo._transfer is not None  # its segments may look like anything
        answers = drive.on_frame(identifier, data, now)
        for answer in answers:
            check_legal(drive, *answer)
        replies = [a for i, a in answers if i == 0x580 + NODE]
        if not block and identifier == 0x600 + NODE:
            assert len(replies) <= 1
            assert all(reply[0] in SERVER_COMMANDS for reply in replies)
            if len(data) == 8 and data[0] != 0x80 and replies:
                assert replies[0][1:4] == data[1:4]
        now += pause
        for answer in drive.on_timer(now):
            check_legal(drive, *answer)
        assert drive.next_timer >= now - 0.3
        for axis in drive.axes:
            assert axis.statusword() & 0x4F in {state.value & 0x4F for state in State}
            assert abs(axis.position) < 1e12
            assert axis.value(0x6061) in (0, 1, 3, 4, 6, 7, 8, 9, 10)


LAYOUTS = {1: "Bb", 2: "Hh", 4: "Ii"}


@settings(max_examples=examples(200), deadline=None)
@given(st.data())
def test_what_was_written_is_read_and_nothing_else_has_changed(data):
    bench = Bench()
    dictionary = bench.drive.dictionary
    keys = [key for key, v in dictionary.variables.items() if v.type.size and key[0] >= 0x6000]
    key = data.draw(st.sampled_from(keys))
    variable = dictionary.variables[key]
    number = data.draw(st.integers(*variable.type.limits))
    before = dict(dictionary.values)
    layout = variable.type.layout[1:]
    refused = bench.abort_of(bench.write, *key, number, layout)
    if refused:
        assert refused >> 16 in (0x0601, 0x0604, 0x0609)
        assert dictionary.values == before
        return
    assert variable.access == "rw"
    assert bench.read(*key, layout) == number
    assert {k: v for k, v in dictionary.values.items() if k != key} == {
        k: v for k, v in before.items() if k != key
    }


@settings(max_examples=examples(100), deadline=None)
@given(
    st.binary(min_size=1, max_size=600),
    st.integers(1, 127),
    st.sets(st.integers(0, 85), max_size=10),
)
def test_block_download_with_lost_segments_arrives_whole(content, window, lost):
    """A client that sends again from the last segment that was confirmed, after any losses."""
    bench = Bench()
    bench.drive._sdo._block = window
    bench.ask(struct.pack("<BHBI", 0xC2, 0x2000, 0, len(content)).hex())
    pieces = [content[n : n + 7].ljust(7, b"\0") for n in range(0, len(content), 7)]
    done, sent = 0, 0
    while done < len(pieces):
        block = pieces[done : done + window]
        confirmed = None
        for number, piece in enumerate(block, 1):
            ends = done + number == len(pieces)
            sent += 1
            if sent in lost and number != len(block):
                continue
            head = number | (0x80 if ends else 0)
            for _, answer in bench.frame(0x605, bytes((head,)) + piece):
                assert answer.startswith("a2")
                confirmed = int(answer[3:5], 16)
        assert confirmed is not None
        done += confirmed
    end = struct.pack("<BH5x", 0xC1 | (-len(content) % 7) << 2, 0)
    assert bench.ask(end.hex()).startswith("a1")
    assert bench.drive.dictionary.values[0x2000, 0] == content
