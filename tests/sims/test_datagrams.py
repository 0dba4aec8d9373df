"""Ways in which datagrams go wrong."""

from __future__ import annotations

from crtk_sim_backends.kit.datagrams import FaultyWay, Late


def test_what_is_late_arrives_when_the_fault_ends_or_another_takes_its_place() -> None:
    way = FaultyWay()
    way.begin("late", Late(every=1, by=10))
    assert way.through([b"one"]) == []
    way.begin("late", Late(every=2, by=10))
    assert way.through([b"two"]) == [b"one", b"two"]
    assert way.through([b"three"]) == []
    way.end("late")
    assert way.through([b"four"]) == [b"three", b"four"]
