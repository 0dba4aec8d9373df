"""Clients' threads wait for cycles; the I/O thread never waits for them."""

import threading

import pytest

from crtk_drivers.engine.turns import Turns
from rigs.waiting import LONG


def test_what_holds_already_is_not_waited_for():
    assert Turns().wait_for(lambda: True, 0.0)


def test_it_is_tested_after_each_turn_until_it_holds():
    turns, tested, held = Turns(), threading.Semaphore(0), threading.Event()

    def test() -> bool:
        tested.release()
        return held.is_set()

    found: list[bool] = []
    client = threading.Thread(target=lambda: found.append(turns.wait_for(test, LONG)))
    client.start()
    for _ in range(2):  # once before it waits, once when it does
        assert tested.acquire(timeout=LONG)
    turns.turn()
    assert tested.acquire(timeout=LONG)
    assert client.is_alive()
    held.set()
    turns.turn()
    client.join(LONG)
    assert found == [True]


def test_what_never_holds_ends_in_time_and_leaves_nothing():
    turns = Turns()
    assert not turns.wait_for(lambda: False, 0.0)
    assert not turns.wait_for(lambda: False, 0.01)
    assert turns._waiting == ()


def test_what_is_raised_leaves_nothing():
    turns, tested = Turns(), []

    def test() -> bool:
        tested.append(True)
        if len(tested) > 1:
            raise ZeroDivisionError
        return False

    with pytest.raises(ZeroDivisionError):
        turns.wait_for(test, LONG)
    assert turns._waiting == ()
