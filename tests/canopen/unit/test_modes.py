"""Modes, the set-point handshake of profile position, and homing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.homing import (
    METHODS,
    Homing,
    HomingCode,
    HomingPhase,
    homing_code,
    method_text,
)
from crtk_driver_canopen.modes import (
    MODES,
    HandshakePhase,
    ModeChange,
    OpMode,
    SetpointHandshake,
    mode_text,
    status_text,
    supported,
)

ENABLED = 0x0237
ACK = 0x1000
REACHED = 0x0400
DT = 0.004


def test_supported_modes() -> None:
    named = {"PP": 0, "VL": 1, "PV": 2, "TQ": 3, "HM": 5, "IP": 6, "CSP": 7, "CSV": 8, "CST": 9}
    for name, bit in named.items():
        assert supported(1 << bit) == {OpMode[name]}
    assert supported(0x3E5 | 0xFFFF0000) == {
        OpMode.PP,
        OpMode.PV,
        OpMode.HM,
        OpMode.IP,
        OpMode.CSP,
        OpMode.CSV,
        OpMode.CST,
    }
    assert {int(mode) for mode in MODES} == {1, 2, 3, 4, 6, 7, 8, 9, 10}


@pytest.mark.parametrize(
    ("word", "mode", "text"),
    [
        (0x1637, 1, "operation enabled, remote, target reached, set-point acknowledged"),
        (0x3237, 8, "operation enabled, remote, follows the command, following error"),
        (0x1637, 6, "operation enabled, remote, target reached, homing attained"),
        (0x02C0, 3, "switch on disabled, warning, remote, no voltage"),
        (0x0818, -3, "fault, internal limit"),
        (0x0001, 0, "no state, no voltage"),
    ],
)
def test_a_statusword_in_words(word: int, mode: int, text: str) -> None:
    assert status_text(word, mode) == text


def test_modes_in_words() -> None:
    assert mode_text(8) == "cyclic synchronous position"
    assert mode_text(0) == "no mode"
    assert mode_text(-3) == "mode -3"


def test_any_mode_is_right_before_one_is_wanted() -> None:
    change = ModeChange(timeout=0.5)
    for now in (1.0, 1.4, 9.0):
        assert change.step(8, now)
        assert change.done
        assert not change.failure


def test_a_change_of_mode_is_waited_for() -> None:
    change = ModeChange(timeout=0.5)
    change.request(8)
    assert not change.step(0, 1.0)
    assert not change.step(0, 1.4)
    assert not change.failure
    assert not change.step(0, 1.6)
    assert "still shows no mode 0.5 s after cyclic synchronous position" in change.failure
    assert change.step(8, 2.0)
    assert not change.failure
    change.request(9)
    assert not change.step(8, 3.0)
    assert not change.failure


class Positioner:
    """A drive in profile position mode that takes `way` cycles to a target."""

    def __init__(self, way: int, stale: bool = True) -> None:
        self.way = way
        self.left = 0
        self.ack = False
        self.reached = stale
        self.last = 0
        self.taken = 0

    def take(self, bits: int) -> int:
        if bits & ~self.last & 0x10 and not self.ack:
            self.ack, self.left, self.taken = True, self.way, self.taken + 1
            self.reached = self.way == 0
        elif not bits & 0x10:
            self.ack = False
        if self.left:
            self.left -= 1
            self.reached = self.left == 0
        self.last = bits
        return ENABLED | (ACK if self.ack else 0) | (REACHED if self.reached else 0)


@pytest.mark.parametrize("way", [0, 1, 2, 50])
def test_a_setpoint_is_handed_over_once_and_its_end_is_its_own(way: int) -> None:
    drive, handshake = Positioner(way), SetpointHandshake()
    word = ENABLED | REACHED  # of the last set-point
    handshake.start()
    sent = []
    cycles = 0
    while handshake.phase is not HandshakePhase.REACHED:
        bits = handshake.step(word, cycles * DT)
        sent.append(bits)
        if bits & 0x10:
            assert handshake.sends_target
        word = drive.take(bits)
        cycles += 1
        assert cycles < 100
    assert drive.taken == 1
    assert drive.left == 0
    assert cycles > way
    # The target is on its way for a cycle before bit 4 rises; bit 5 is set throughout.
    assert [bits & 0x10 for bits in sent[:4]] == [0, 0, 0x10, 0]
    assert all(bits & 0x20 for bits in sent[:-1])


def test_a_setpoint_waits_for_the_last_acknowledgement_to_go() -> None:
    handshake = SetpointHandshake()
    handshake.start()
    assert [handshake.step(ENABLED | ACK, n * DT) & 0x10 for n in range(10)] == [0] * 10
    assert handshake.phase is HandshakePhase.CLEAR
    handshake.step(ENABLED, 10 * DT)
    assert handshake.phase is HandshakePhase.TARGET


def test_the_last_target_reached_does_not_count_while_the_acknowledgement_stays() -> None:
    handshake = SetpointHandshake()
    handshake.start()
    words = [ENABLED | REACHED] * 3 + [ENABLED | REACHED | ACK] * 300
    for n, word in enumerate(words):
        handshake.step(word, n * DT)
        assert handshake.phase < HandshakePhase.MOVING or handshake.failure
    assert "does not withdraw" in handshake.failure


@pytest.mark.parametrize(
    ("word", "text"),
    [
        (ENABLED | ACK, "still acknowledges the last"),
        (ENABLED, "does not acknowledge"),
    ],
)
def test_a_drive_that_does_not_take_part_is_told(word: int, text: str) -> None:
    handshake = SetpointHandshake(relative=True)
    handshake.start()
    for n in range(600):
        handshake.step(word, n * DT)
    assert handshake.phase is HandshakePhase.FAILED
    assert text in handshake.failure
    assert handshake.step(word, 10.0) == 0


def test_a_setpoint_ends_with_the_power() -> None:
    handshake = SetpointHandshake()
    handshake.start()
    handshake.step(ENABLED, 0.0)
    assert handshake.step(0x0218, DT) == 0
    assert handshake.failure == "the drive is fault"


# Homing


def code_word(code: HomingCode) -> int:
    bits = code.value
    return ENABLED | (bits >> 2 & 1) << 13 | (bits >> 1 & 1) << 12 | (bits & 1) << 10


@pytest.mark.parametrize(
    ("word", "code"),
    [
        (0x0237, HomingCode.RUNNING),
        (0x0637, HomingCode.NOT_RUNNING),
        (0x1237, HomingCode.ATTAINED_MOVING),
        (0x1637, HomingCode.DONE),
        (0x2237, HomingCode.ERROR_MOVING),
        (0x2637, HomingCode.ERROR),
        (0x3637, HomingCode.RESERVED_7),
    ],
)
def test_the_bits_of_homing(word: int, code: HomingCode) -> None:
    assert homing_code(word) is code


class Run:
    """A homing against a scripted drive: what it shows before the start, and after it, cycle by cycle."""

    def __init__(self, method: int, before: HomingCode, after: list[HomingCode]) -> None:
        self.homing = Homing(method, timeout=20.0)
        self.homing.start()
        self.bits: list[int] = []
        self._after = after
        self._before = before
        self._shown = 0
        self._now = 0.0

    def until_over(self, cancel_at: int = -1) -> Homing:
        bits = 0
        for cycle in range(10_000):
            if cycle == cancel_at:
                self.homing.cancel()
            mode = 8 if cycle < 5 else 6
            word = code_word(HomingCode.DONE if mode == 8 else self._before)
            if bits & 0x10:
                word = code_word(self._after[min(self._shown, len(self._after) - 1)])
                self._shown += 1
            elif bits & 0x100:
                word = code_word(HomingCode.NOT_RUNNING)
            bits = self.homing.step(word, mode, cycle * DT)
            self.bits.append(bits)
            if self.homing.over:
                return self.homing
        raise AssertionError(f"still {self.homing.phase}")


_C = HomingCode
LONG = [_C.RUNNING] * 50


@pytest.mark.parametrize(
    ("method", "before", "after"),
    [
        (17, _C.NOT_RUNNING, [*LONG, _C.ATTAINED_MOVING, _C.DONE]),
        (17, _C.DONE, [_C.DONE, _C.DONE, *LONG, _C.DONE]),  # the old result stays for a while
        (17, _C.RUNNING, [*LONG, _C.DONE]),
        (17, _C.ERROR, [_C.ERROR, *LONG, _C.DONE]),
        (17, _C.NOT_RUNNING, [_C.NOT_RUNNING, *LONG, _C.DONE]),
        (37, _C.NOT_RUNNING, [_C.DONE]),
        (37, _C.DONE, [_C.DONE]),
        (35, _C.RUNNING, [_C.DONE]),
    ],
)
def test_a_homing_that_succeeds(method: int, before: HomingCode, after: list[HomingCode]) -> None:
    run = Run(method, before, after)
    homing = run.until_over()
    assert (homing.phase, homing.failure) == (HomingPhase.DONE, "")
    assert sum(bits == 0x10 for bits in run.bits) >= min(len(after), 13 if before is _C.DONE else 1)
    assert homing.step(ENABLED, 6, 100.0) == 0


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        (_C.DONE, [_C.DONE], "does not begin"),  # a result that never changes is not believed
        (_C.NOT_RUNNING, [_C.NOT_RUNNING], "does not begin"),
        (_C.NOT_RUNNING, [*LONG, _C.NOT_RUNNING], "interrupted"),
        (_C.NOT_RUNNING, [*LONG, _C.ERROR_MOVING, _C.ERROR], "reports a homing error"),
        (_C.NOT_RUNNING, [_C.ERROR], "reports a homing error"),
        (_C.NOT_RUNNING, [_C.RUNNING], "not done"),
    ],
)
def test_a_homing_that_fails(before: HomingCode, after: list[HomingCode], text: str) -> None:
    homing = Run(17, before, after).until_over()
    assert homing.phase is HomingPhase.FAILED
    assert text in homing.failure
    assert "method 17 (negative limit switch)" in homing.failure


@pytest.mark.parametrize("at", [2, 30, 60])
def test_a_homing_can_be_cancelled(at: int) -> None:
    run = Run(17, _C.NOT_RUNNING, [_C.RUNNING])
    homing = run.until_over(cancel_at=at)
    assert homing.phase is HomingPhase.CANCELLED
    assert all(bits != 0x10 for bits in run.bits[at:])


def test_bits_of_another_mode_are_no_result_when_the_mode_has_just_changed() -> None:
    homing = Homing(17)
    homing.start()
    now = 0.0
    for code in [_C.RUNNING] * 3 + [_C.DONE] * 2000:  # old bits at first, then the last result
        homing.step(code_word(code), 6, now)
        now += DT
    assert homing.phase is HomingPhase.FAILED
    assert "does not begin" in homing.failure


def test_homing_waits_for_its_mode_and_ends_with_it() -> None:
    homing = Homing(17)
    homing.start()
    bits = [homing.step(code_word(_C.DONE), 8, n * DT) for n in range(400)]
    assert set(bits) == {0}
    assert "does not show homing mode" in homing.failure
    homing.start()
    for n in range(100):
        homing.step(code_word(_C.RUNNING), 6, n * DT)
    assert homing.phase is HomingPhase.RUNNING
    homing.step(code_word(_C.RUNNING), 8, 1.0)
    assert "shows cyclic synchronous position" in homing.failure


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.sampled_from([6, 8])), max_size=80))
def test_homing_succeeds_only_by_a_result_in_its_mode(words: list[tuple[int, int]]) -> None:
    homing = Homing(17)
    homing.start()
    for n, (word, mode) in enumerate(words):
        was = homing.phase
        bits = homing.step(word, mode, n * 0.02)
        assert bits in (0, 0x10)
        if homing.phase is HomingPhase.DONE and was is not HomingPhase.DONE:
            assert mode == 6
            assert homing_code(word) is HomingCode.DONE
            assert was in (HomingPhase.START, HomingPhase.RUNNING)


def test_methods_have_words() -> None:
    assert set(METHODS) == {*range(1, 15), *range(17, 31), 33, 34, 35, 37}
    assert method_text(2) == "positive limit switch and index"
    assert (
        method_text(7)
        == "home switch from the negative side, falling edge, and index, first upwards"
    )
    assert method_text(-3) == "of the manufacturer"
    assert method_text(15) == "reserved"
    assert method_text(0) == "no homing"
