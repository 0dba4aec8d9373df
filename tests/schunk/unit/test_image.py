"""The process image, the parameters and the handshake, without a wire."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_schunk.gripper.faults import ERRORS, WARNINGS, fault_of
from crtk_driver_schunk.gripper.grip import LAG, STILL, Grip
from crtk_driver_schunk.gripper.handshake import ANSWERED, Handshake
from crtk_driver_schunk.gripper.image import IDLE, Command, Control, State, Status
from crtk_driver_schunk.gripper.parameters import ASKED, MODELS, describe
from crtk_drivers.kit.gripping import HELD, ON_ITS_WAY, Doing

MOVE = Command(Control.RUN | Control.MOVE, position=0.08, speed=0.07)
GRIP = Command(Control.RUN | Control.GRIP, force=50)
STOP = Command(Control.RUN | Control.STOP)
RELEASE = Command(Control.RUN | Control.RELEASE)


def test_commands_as_bytes() -> None:
    """As SCHUNK's library sends them."""
    assert IDLE.image("<").hex() == "01000000000000000000000000000000"
    assert MOVE.image("<").hex() == "01200000803801007011010000000000"
    assert GRIP.image("<").hex() == "01100000000000000000000032000000"
    assert MOVE.image(">").hex() == "00002001000138800001117000000000"
    outwards = Command(Control.RUN | Control.GRIP | Control.OUTWARD | Control.KEEP, force=100)
    assert outwards.image("<").hex() == "81100080000000000000000064000000"
    assert Command(Control(0)).image("<") == bytes(16), "a fast stop"


@pytest.mark.parametrize(
    ("image", "order"),
    [("800000800000A25800000000000000EF", ">"), ("8000008058A2000000000000EF000000", "<")],
)
def test_a_status_of_a_gripper_that_was_powered_on(image: str, order: str) -> None:
    """The first is from a PROFINET module; error EF: no fieldbus."""
    status = Status.parse(bytes.fromhex(image), order)  # type: ignore[arg-type]
    assert status.bits == State.ERROR | State.KEEPS
    assert status.position == pytest.approx(0.04156)
    assert (status.error, status.warning) == (0xEF, 0)


@given(st.binary(max_size=40), st.sampled_from("<>"))
def test_any_bytes_are_a_status_or_refused(data: bytes, order: str) -> None:
    if len(data) != 16:
        with pytest.raises(ValueError, match="bytes as status"):
            Status.parse(data, order)  # type: ignore[arg-type]
        return
    status = Status.parse(data, order)  # type: ignore[arg-type]
    assert abs(status.position) <= 2148.0
    assert 0 <= status.error <= 255
    assert fault_of(status.error).remedy


def test_every_code_has_words() -> None:
    assert len(MODELS) == 34
    assert MODELS[6] == "EGU 50 N-B"
    assert MODELS[18] == "EGK 40 M-B"
    assert MODELS[39] == "EZU 40 M-SD"
    assert all(fault.text and fault.remedy for fault in ERRORS.values())
    assert all(WARNINGS.values())
    assert "no table" in fault_of(0x33).text
    assert fault_of(0xD9).text.endswith("(D9)")


# ----------------------------------------------------------------------------------------- parameters


def told(order: str, **changed: bytes) -> dict[str, bytes]:
    """What a gripper tells of itself."""
    numbers = {"lower": 0.0, "upper": 83.0, "speed": 115.0, "max_force": 150.0}
    values = {name: struct.pack(f"{order}f", value) for name, value in numbers.items()}
    values |= {"serial": b"NSNS".ljust(16, b"\0"), "firmware": b"5.2.0.81896".ljust(22, b"\0")}
    bus = bytes((1 if order == ">" else 7, 0))
    return {**values, "fieldbus": bus, "model": bytes((18,)), **changed}


@pytest.mark.parametrize("order", ["<", ">"])
def test_what_a_gripper_tells_of_itself(order: str) -> None:
    assert struct.unpack(">f", bytes.fromhex("42A60000")) == (83.0,), (
        "as the vendor's PROFINET data"
    )
    found = describe(told(order))
    assert (found.order, found.upper, found.speed) == (order, 0.083, pytest.approx(0.115))
    assert (found.model, found.serial, found.firmware) == ("EGK 40 M-B", "NSNS", "5.2.0.81896")
    assert found.has_brake
    assert not describe(told(order, model=bytes((15,)))).has_brake


@pytest.mark.parametrize(
    "changed",
    [
        {"upper": b"\0\0"},
        {"upper": struct.pack("<f", float("nan"))},
        {"upper": struct.pack("<f", -1.0)},
        {"max_force": struct.pack("<f", float("inf"))},
        {"fieldbus": b""},
    ],
)
def test_what_no_gripper_tells_is_refused(changed: dict[str, bytes]) -> None:
    with pytest.raises(ValueError, match=r"range|bytes"):
        describe(told("<", **changed))


@given(st.fixed_dictionaries({name: st.binary(max_size=30) for name in ASKED}))
def test_any_values_are_a_gripper_or_refused(values: dict[str, bytes]) -> None:
    try:
        found = describe(values)
    except ValueError:
        return
    assert found.lower < found.upper


# ------------------------------------------------------------------------------------------ handshake


class Gripper:
    """What answers a handshake."""

    def __init__(self, shaken: Handshake) -> None:
        self.shaken, self.toggle, self.now = shaken, False, 0.0
        self.written: list[Command] = []
        self.is_deaf = False

    def turn(self) -> Command | None:
        """Let the driver write until it reads; return what is taken."""
        while (command := self.shaken.to_write()) is not None:
            if not self.is_deaf and command != (self.written or [None])[-1] and command != IDLE:
                self.toggle = not self.toggle
            self.written.append(command)
            self.shaken.written(self.now)
        bits = State.READY | (State.TOGGLE if self.toggle else State(0))
        taken = self.shaken.seen(Status(bits, 0.0, 0, 0, 0), self.now)
        self.now += 0.01
        return taken


@pytest.fixture
def gripper() -> Gripper:
    return Gripper(Handshake())


def test_a_command_is_an_idle_image_and_the_command(gripper: Gripper) -> None:
    assert gripper.turn() is None
    gripper.shaken.ask(MOVE)
    assert gripper.turn() is None
    assert gripper.turn() is MOVE
    assert gripper.written == [IDLE, MOVE]
    assert gripper.shaken.pending is None
    gripper.turn()
    assert gripper.written == [IDLE, MOVE], "and no more"


def test_the_same_command_twice_is_two(gripper: Gripper) -> None:
    for _ in range(2):
        gripper.shaken.ask(GRIP)
        while gripper.turn() is None:
            pass
    assert gripper.written == [IDLE, GRIP, IDLE, GRIP]


def test_the_newest_waits_and_what_is_under_way_ends(gripper: Gripper) -> None:
    gripper.shaken.ask(MOVE)
    gripper.turn()
    gripper.shaken.ask(GRIP)
    gripper.shaken.ask(IDLE)
    gripper.shaken.ask(GRIP)
    taken = [gripper.turn() for _ in range(5)]
    assert [command for command in taken if command] == [MOVE, GRIP]


def test_a_stop_does_not_wait(gripper: Gripper) -> None:
    gripper.shaken.ask(MOVE)
    gripper.turn()
    gripper.shaken.ask(STOP)
    taken = [gripper.turn() for _ in range(4)]
    assert [command for command in taken if command] == [STOP]
    assert MOVE not in gripper.written


def test_what_is_not_taken_is_handed_over_again(gripper: Gripper) -> None:
    gripper.is_deaf = True
    gripper.shaken.ask(MOVE)
    for _ in range(round(3.5 * ANSWERED / 0.01)):
        assert gripper.turn() is None
    assert gripper.shaken.attempts >= 2
    assert gripper.shaken.pending is MOVE
    gripper.is_deaf = False
    while gripper.turn() is not MOVE:
        assert gripper.now < 10.0
    assert gripper.shaken.attempts == 0
    assert gripper.shaken.repeated >= 2


def test_what_was_not_written_can_be_withdrawn(gripper: Gripper) -> None:
    gripper.shaken.ask(MOVE)
    gripper.turn()
    assert gripper.shaken.withdraw(), "the idle image only"
    gripper.turn()
    assert MOVE not in gripper.written
    gripper.is_deaf = True
    gripper.shaken.ask(GRIP)
    gripper.turn()
    gripper.turn()
    assert not gripper.shaken.withdraw(), "it may have been taken"


def test_what_may_have_been_written_is_followed_by_a_stop(gripper: Gripper) -> None:
    """Its acknowledgement is late: the gripper may take it yet."""
    gripper.shaken.ask(MOVE)
    gripper.turn()
    assert gripper.shaken.to_write() is MOVE, "on its way"
    assert not gripper.shaken.withdraw()
    assert gripper.shaken.to_write() is None, "not again"
    gripper.shaken.ask(STOP)
    while gripper.turn() is not STOP:
        assert gripper.now < 1.0


def test_what_is_withdrawn_is_not_handed_over_later(gripper: Gripper) -> None:
    gripper.is_deaf = True
    gripper.shaken.ask(RELEASE)
    gripper.turn()
    gripper.turn()
    assert not gripper.shaken.withdraw()
    while gripper.shaken.pending is not None:
        gripper.turn()
        assert gripper.now < 2.0 * ANSWERED
    gripper.is_deaf = False
    for _ in range(round(2.0 * ANSWERED / 0.01)):
        assert gripper.turn() is None
    assert gripper.written == [IDLE, RELEASE]


def test_commands_of_others_are_counted(gripper: Gripper) -> None:
    gripper.turn()
    gripper.toggle = True
    gripper.turn()
    gripper.turn()
    assert gripper.shaken.by_others == 1


# ----------------------------------------------------------------------------------------------- grip


def seen(grip: Grip, bits: State, now: float, position: float = 0.0) -> Doing:
    grip.see(Status(bits, position, 0, 0, 0), now)
    return grip.doing


THERE = State.SUCCESS | State.POSITION


def test_an_end_that_is_of_the_command_before_is_not_believed() -> None:
    grip = Grip()
    assert seen(grip, THERE, 0.0) is Doing.THERE
    grip.taken(GRIP, 1.0)
    assert seen(grip, THERE, 1.01) is Doing.MOVING
    assert seen(grip, State(0), 1.02, 0.001) is Doing.MOVING
    assert seen(grip, State.PRE_GRIP, 1.03, 0.002) is Doing.PRESSING
    assert grip.doing in ON_ITS_WAY
    assert seen(grip, State.GRIPPED | State.SUCCESS, 1.04) is Doing.HOLDS
    assert grip.doing in HELD


def test_a_command_that_ends_at_once_is_believed_after_a_while() -> None:
    grip = Grip()
    grip.taken(MOVE, 1.0)
    assert seen(grip, THERE, 1.0 + 0.9 * LAG) is Doing.MOVING
    assert seen(grip, THERE, 1.0 + 1.1 * LAG) is Doing.THERE


def test_an_arrival_elsewhere_is_that_of_the_move_before() -> None:
    """It was told to move still when the command was taken, and then that it is there."""
    grip = Grip()
    grip.taken(MOVE, 1.0)
    assert seen(grip, State(0), 1.01, 0.0398) is Doing.MOVING
    assert seen(grip, THERE, 1.02, 0.04) is Doing.MOVING
    assert seen(grip, State(0), 1.03, 0.041) is Doing.MOVING
    assert seen(grip, THERE, 1.04, MOVE.position) is Doing.THERE


def test_an_error_is_believed_at_once() -> None:
    grip = Grip()
    grip.taken(MOVE, 1.0)
    assert seen(grip, State.ERROR, 1.01) is Doing.ERROR


def test_one_that_reports_nothing_rests_when_it_stands() -> None:
    grip = Grip()
    assert seen(grip, State.READY, 0.0) is Doing.UNKNOWN
    assert grip.doing in ON_ITS_WAY
    assert seen(grip, State.READY, 0.1, 0.001) is Doing.MOVING
    assert seen(grip, State.READY, 0.1 + 1.1 * STILL, 0.001) is Doing.STOPPED


def test_a_stop_is_no_arrival() -> None:
    grip = Grip()
    grip.taken(STOP, 1.0)
    assert seen(grip, THERE, 1.01) is Doing.STOPPED


def test_a_stop_that_may_have_been_taken_is_no_arrival_either() -> None:
    """The watchdog's, which is written past the handshake."""
    grip = Grip()
    grip.taken(GRIP, 1.0)
    grip.see(Status(State.READY | THERE, 0.0, 0, 0, 0), 2.0, stops=True)
    assert grip.doing is Doing.STOPPED


def test_a_command_that_a_stop_replaces_is_not_another_masters(gripper: Gripper) -> None:
    """Its acknowledgement is late: that it was taken shows only after the idle image of the stop."""
    gripper.turn()
    gripper.shaken.ask(MOVE)
    gripper.turn()
    assert gripper.shaken.to_write() is MOVE, "on its way"
    gripper.toggle = not gripper.toggle
    gripper.shaken.ask(STOP)
    while gripper.turn() is not STOP:
        assert gripper.now < 1.0
    assert gripper.shaken.by_others == 0
    gripper.toggle = not gripper.toggle
    gripper.turn()
    assert gripper.shaken.by_others == 1


def test_a_stop_that_is_written_past_the_handshake_is_not_another_masters(gripper: Gripper) -> None:
    gripper.turn()
    gripper.shaken.has_shouted = True
    gripper.toggle = not gripper.toggle
    gripper.turn()
    assert gripper.shaken.by_others == 0
    gripper.toggle = not gripper.toggle
    gripper.turn()
    assert gripper.shaken.by_others == 1


@pytest.mark.parametrize(
    ("bits", "doing"),
    [
        (State.LOST, Doing.LOST),
        (State.GRIPPED | State.SUCCESS | State.WRONG_PART, Doing.WRONG),
        (State.NO_PART, Doing.NOTHING),
        (State.NOT_FEASIBLE, Doing.REFUSED),
    ],
)
def test_ends_of_other_kinds(bits: State, doing: Doing) -> None:
    assert seen(Grip(), bits, 0.0) is doing
