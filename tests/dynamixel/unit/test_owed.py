"""Which replies may still come: whatever is held back for however long, nothing old is taken for new."""

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.owed import Owed

IDS = st.integers(1, 3)
LENGTHS = st.integers(0, 4)


def status(id, length, error=0):
    return Status(id, error, False, bytes(length))


def test_at_first_nothing_is_owed():
    owed = Owed()
    assert owed.none
    assert not owed.is_ambiguous(1, 4)
    assert not owed.holds(status(1, 4))


def test_a_reply_that_was_missed_is_owed_to_whatever_follows():
    owed = Owed()
    owed.missed(1, 4)
    assert not owed.is_ambiguous(1, 4), "to the same, once more, it is as good"
    owed.begin()
    assert owed.is_ambiguous(1, 4)
    assert not owed.is_ambiguous(1, 2)
    assert not owed.is_ambiguous(2, 4)
    assert owed.holds(status(1, 4))
    assert owed.holds(status(1, 0, error=7)), "a refusal, which has no data"
    assert not owed.holds(status(2, 0, error=7))


def test_an_answer_shows_that_nothing_older_comes():
    owed = Owed()
    owed.missed(1, 4)
    owed.begin()
    owed.answered(again=False)
    assert owed.none


def test_a_probe_is_none_of_what_is_owed():
    owed = Owed()
    for length in (1, 2, 4):
        owed.missed(1, length)
    owed.begin()
    assert owed.probe(1, 3) == 5
    assert owed.probe(1, 3) == 5, "the same shows as much"
    owed.probed()
    assert not owed.is_ambiguous(1, 4)
    assert owed.is_ambiguous(1, 5), "it was asked for twice"
    assert owed.probe(1, 5) == 1
    owed.probed()
    assert not owed.is_ambiguous(1, 5)


def test_a_chain_without_power_is_always_asked_for_the_same():
    owed = Owed()
    for id in (1, 2, 3):
        owed.missed(id, 10)
    found = set()
    for _ in range(1000):
        for id in (1, 2, 3):
            owed.begin()
            assert owed.is_ambiguous(id, 10)
            found.add(owed.probe(id, 10))
    assert found == {1}


class Wire:
    """Replies come in the order of the requests, each some requests later."""

    def __init__(self):
        self.now = 0
        self.owed = Owed()
        self._held = deque()

    def ask(self, id, length, *, is_probe, comes):
        """Ask, and let so many of the held replies come; return the number of the one that is taken."""
        self.now += 1
        self._held.append((id, length, self.now))
        holds = self.owed.holds_besides_probes if is_probe else self.owed.holds
        taken = 0
        for _ in range(min(comes, len(self._held))):
            servo, size, number = self._held.popleft()
            if not taken and not holds(status(servo, size)) and (servo, size) == (id, length):
                taken = number
        return taken


@given(st.lists(st.tuples(IDS, LENGTHS, st.integers(0, 6), st.integers(0, 6)), max_size=60))
def test_no_reply_is_taken_for_that_to_a_later_request(asked):
    wire = Wire()
    owed = wire.owed
    for id, length, first, second in asked:
        owed.begin()
        if owed.is_ambiguous(id, length):
            if not wire.ask(id, owed.probe(id, length), is_probe=True, comes=first):
                continue
            owed.probed()
        number = wire.ask(id, length, is_probe=False, comes=second)
        assert number in (0, wire.now)
        if number:
            owed.answered(again=False)
        else:
            owed.missed(id, length)
