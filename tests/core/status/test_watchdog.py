"""Deadlines."""

import math

from crtk_drivers.status.deadman import Deadman


def test_it_expires_when_it_is_not_fed_in_time() -> None:
    deadman = Deadman(0.5)
    deadman.feed(10.0)
    assert not deadman.expired(10.5)
    assert deadman.expired(10.501)
    deadman.feed(10.501)
    assert not deadman.expired(11.0)
    assert deadman.age(11.0) == 11.0 - 10.501


def test_unarmed_it_never_expires() -> None:
    deadman = Deadman(0.5)
    assert not deadman.armed
    assert not deadman.expired(1e9)
    assert deadman.age(0.0) == math.inf
    deadman.feed(0.0)
    assert deadman.armed
    deadman.disarm()
    assert not deadman.expired(1e9)


def test_it_can_be_fed_ahead() -> None:
    deadman = Deadman(0.5)
    deadman.feed(20.0)
    assert not deadman.expired(10.0)
    assert not deadman.expired(20.5)
    assert deadman.expired(20.6)


def test_one_that_is_disarmed_while_it_is_looked_at_does_not_expire() -> None:
    class Racing(Deadman):
        looks = 0

        @property
        def _fed(self) -> float:
            self.looks += 1
            return 10.0 if self.looks == 1 else -math.inf

        @_fed.setter
        def _fed(self, value: float) -> None:
            pass

    assert not Racing(0.5).expired(10.1)
