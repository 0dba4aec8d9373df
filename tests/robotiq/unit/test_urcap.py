"""The text server's lines, with and without an end."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_robotiq.registers import Activation, Command, Contact
from crtk_driver_robotiq.urcap import EACH, IN_TURN, Answers, get_line, set_line, status_of


def test_lines_that_are_sent() -> None:
    moving = Command(go=True, position=100, speed=255, force=7)
    assert set_line(moving) == b"SET POS 100 SPE 255 FOR 7 GTO 1\n"
    assert set_line(replace(moving, only_goal=True)) == b"SET POS 100 SPE 255 FOR 7\n"
    assert set_line(Command()) == b"SET ACT 1 GTO 0\n"
    assert set_line(Command(position=100, halts=True)) == b"SET GTO 0\n", "activates nothing"
    assert set_line(Command(activate=False)) == b"SET ACT 0 GTO 0\n"
    assert get_line("POS") == b"GET POS\n"


@given(st.integers(0, 255), st.integers(0, 8))
def test_an_answer_with_an_end_may_be_cut_anywhere(value: int, cut: int) -> None:
    answers, line = Answers(), f"POS {value}\n".encode()
    first = answers.value("POS", line[:cut])
    assert (value if cut >= len(line) else None) == first
    if first is None:
        assert answers.value("POS", line[cut:]) == value
    assert answers.ends_lines


def test_what_has_no_end_is_none() -> None:
    answers = Answers()
    with pytest.raises(ValueError, match="and goes on"):
        answers.value("POS", b"POS 1" + b"1" * 100)


def test_an_answer_without_an_end_is_whole_when_it_is_quiet() -> None:
    answers = Answers()
    assert answers.value("POS", b"POS 1") is None
    assert answers.value("POS", b"23") is None
    assert answers.value("POS", b"", quiet=True) == 123
    assert answers.ends_lines is False


def test_a_server_that_ends_lines_is_waited_for() -> None:
    """Of "POS 123" the beginning is a number too."""
    answers = Answers()
    assert answers.value("POS", b"POS 3\n") == 3
    assert answers.value("POS", b"POS 1", quiet=True) is None
    assert answers.value("POS", b"23\n") == 123


@pytest.mark.parametrize("text", [b"?\n", b"OBJ 3\n", b"POS x\n", b"POS 256\n", b"POS -1\n", b"\n"])
def test_what_is_not_expected_is_an_error(text: bytes) -> None:
    with pytest.raises(ValueError, match="instead of POS"):
        Answers().value("POS", text)


def test_an_acknowledgement_has_no_end_and_may_be_cut() -> None:
    answers = Answers()
    assert not answers.ack(b"a")
    assert answers.ack(b"ck")
    with pytest.raises(ValueError, match="instead of"):
        answers.ack(b"?\n")


def test_an_acknowledgement_of_a_stop_from_aside_is_skipped() -> None:
    answers = Answers()
    answers.skip_ack()
    assert answers.value("POS", b"ackPOS 7\n") == 7


def test_all_variables_make_a_status() -> None:
    values = dict.fromkeys((*EACH, *IN_TURN), 0) | {"STA": 3, "OBJ": 2, "FLT": 11, "POS": 77}
    status = status_of(values)
    assert (status.activation, status.contact) == (Activation.DONE, Contact.WHILE_CLOSING)
    assert (status.fault, status.position, status.current) == (11, 77, None)
    with pytest.raises(KeyError):
        status_of({"POS": 1})
