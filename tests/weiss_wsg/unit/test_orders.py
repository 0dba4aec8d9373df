"""Which answer belongs to which command: one that is replaced, refused, lost, doubled or late."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_weiss_wsg.orders import PATIENCE, Order, Orders
from crtk_driver_weiss_wsg.tables import Command, Message, Status

OK, PENDING, ABORTED = Status.OK, Status.PENDING, Status.ABORTED
MOVE, STOP = Command.MOVE, Command.STOP


def move(width: float = 0.01) -> Order:
    return Order(MOVE, (width, 0.1))


def sent(orders: Orders, order: Order, now: float = 0.0) -> Order:
    """Let an order be sent."""
    orders.put(order)
    assert orders.due(now) is order
    return order


def seen(orders: Orders) -> None:
    """It tells its state anew."""
    orders.unseen.clear()


def test_a_move_is_pending_and_ends() -> None:
    orders = Orders()
    order = sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    assert orders.running is order
    assert not orders.settled, "what it tells may be from before"
    seen(orders)
    assert orders.settled
    orders.heed(Message(MOVE, OK))
    assert order.status == OK
    assert orders.running is None


def test_the_next_waits_for_the_first_answer_and_the_newest_counts() -> None:
    orders = Orders()
    sent(orders, move())
    older, newer = move(0.02), move(0.03)
    orders.put(older)
    assert orders.due(0.1) is None
    orders.put(newer)
    assert older.status == ABORTED
    orders.heed(Message(MOVE, PENDING))
    assert orders.due(0.2) is newer


@pytest.mark.parametrize("end", [ABORTED, OK, Status.BLOCKED])
def test_the_end_of_one_that_is_replaced_is_not_that_of_the_next(end: int) -> None:
    orders = Orders()
    first = sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, end))
    assert (first.status, second.status) == (end, None)
    orders.heed(Message(MOVE, PENDING))
    assert orders.running is second


def test_a_gripper_that_never_ends_the_one_that_is_replaced() -> None:
    orders = Orders()
    first = sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, PENDING))
    assert (first.status, orders.running) == (ABORTED, second)


@pytest.mark.parametrize("end", [OK, ABORTED, Status.FAILED])
@pytest.mark.parametrize("how", ["replaced", "believed"])
def test_an_end_that_comes_late_is_not_that_of_the_next(end: int, how: str) -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    if how == "believed":
        seen(orders)
        orders.see(rests=True, now=1.0)
        orders.see(rests=True, now=2.0)
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, PENDING))
    seen(orders)
    orders.see(rests=False, now=3.0)
    orders.heed(Message(MOVE, end))
    assert second.status is None, "that may be the end of the first"
    seen(orders)
    orders.see(rests=False, now=3.1)
    assert (second.status, orders.running) == (None, second)
    orders.heed(Message(MOVE, Status.BLOCKED))
    assert second.status == Status.BLOCKED


def test_the_end_of_the_next_is_believed_where_that_of_the_first_is_never_told() -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, PENDING))
    seen(orders)
    orders.see(rests=False, now=1.0)
    orders.heed(Message(MOVE, Status.FAILED))
    seen(orders)
    orders.see(rests=True, now=1.1)
    assert (second.status, orders.running) == (Status.FAILED, None)


def test_an_end_far_from_the_goal_is_not_that_of_the_next() -> None:
    """That of the first comes late, and the next one has not begun to move when it is told anew."""
    orders = Orders()
    sent(orders, move(0.01))
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, PENDING))
    seen(orders)
    orders.heed(Message(MOVE, OK))
    assert Command.WIDTH in orders.unseen
    seen(orders)
    orders.see(rests=True, now=1.0, width=0.01)
    assert (second.status, orders.running) == (None, second)
    orders.see(rests=False, now=1.1, width=0.015)
    orders.heed(Message(MOVE, OK))
    assert second.status == OK


def test_a_move_that_rests_on_its_way_has_failed() -> None:
    """Its end was not told."""
    orders = Orders()
    order = sent(orders, move(0.02))
    orders.heed(Message(MOVE, PENDING))
    seen(orders)
    orders.see(rests=True, now=1.0, width=0.01)
    orders.see(rests=True, now=1.0 + 1.1 * PATIENCE, width=0.01)
    assert order.status == Status.FAILED


def test_a_doubled_end_is_no_end_of_the_next() -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    orders.heed(Message(MOVE, OK))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, OK))  # the first one's, again
    assert not orders.settled
    orders.heed(Message(MOVE, PENDING))
    assert (second.status, orders.running) == (None, second)


def test_an_end_that_is_never_told_is_believed_when_it_rests() -> None:
    orders = Orders()
    order = sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    orders.see(rests=True, now=0.0)
    orders.see(rests=True, now=9.0)
    assert order.status is None, "that is from before"
    seen(orders)
    orders.see(rests=False, now=10.0)
    orders.see(rests=True, now=11.0)
    orders.see(rests=True, now=11.0 + 0.9 * PATIENCE)
    assert order.status is None
    orders.see(rests=True, now=11.0 + 1.1 * PATIENCE)
    assert order.status == OK


def test_what_is_not_answered_is_sent_again() -> None:
    orders = Orders()
    order = sent(orders, move())
    assert orders.due(0.5 * PATIENCE) is None
    assert orders.due(1.1 * PATIENCE) is order
    assert orders.due(2.3 * PATIENCE) is order
    assert order.tries == 3


@pytest.mark.parametrize("late", [ABORTED, Status.RUNNING])
def test_one_that_was_sent_twice_is_not_ended_by_itself(late: int) -> None:
    orders = Orders()
    order = sent(orders, move())
    assert orders.due(1.1 * PATIENCE) is order
    orders.heed(Message(MOVE, PENDING))
    orders.heed(Message(MOVE, late))
    assert order.status is None
    orders.heed(Message(MOVE, OK))
    assert order.status == OK


def test_a_stop_leaves_out_what_was_not_sent() -> None:
    orders = Orders()
    first = sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move())
    third = move()
    orders.put(third)
    orders.stop()
    stop = orders.due(0.0)
    assert stop is not None
    assert stop.command is STOP
    assert (second.status, third.status) == (ABORTED, ABORTED)
    orders.heed(Message(MOVE, PENDING))  # of the second: too late
    orders.heed(Message(MOVE, ABORTED))
    orders.heed(Message(STOP, OK))
    assert first.status == ABORTED
    seen(orders)
    assert orders.settled
    assert orders.due(1.0) is None


def test_a_stop_leaves_out_a_motion_that_came_after_a_stop_which_is_not_answered_yet() -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    orders.stop()
    assert orders.due(0.0) is not None
    later = move(0.02)
    orders.put(later)
    orders.stop()
    orders.heed(Message(STOP, OK))
    orders.see(rests=True, now=0.1)
    assert orders.due(0.1) is None
    assert later.status == ABORTED


def test_a_stop_leaves_out_a_motion_that_waits_for_a_stop_of_another() -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, Status.RUNNING))
    assert orders.due(0.1) is not None
    orders.stop()
    orders.heed(Message(MOVE, ABORTED))
    orders.heed(Message(STOP, OK))
    orders.see(rests=True, now=0.2)
    assert orders.due(0.2) is None
    assert second.status == ABORTED


def test_a_motion_that_is_refused_for_another_is_sent_again_after_a_stop() -> None:
    orders = Orders()
    sent(orders, move())
    orders.heed(Message(MOVE, PENDING))
    orders.see(rests=False, now=0.0)
    second = sent(orders, move(0.02))
    orders.heed(Message(MOVE, Status.RUNNING))
    stop = orders.due(0.1)
    assert stop is not None
    assert stop.command is STOP
    orders.heed(Message(MOVE, ABORTED))
    orders.heed(Message(STOP, OK))
    assert orders.due(0.2) is None, "it moves"
    orders.see(rests=True, now=0.3)
    assert orders.due(0.3) is second
    for now in (0.4, 0.5, 0.6):  # and once more, and no more
        orders.heed(Message(MOVE, Status.RUNNING))
        if second.status is not None:
            break
        orders.due(now)
        orders.heed(Message(STOP, OK))
        orders.due(now)
    assert second.status == Status.RUNNING


def test_a_grip_is_not_replaced_but_stopped() -> None:
    orders = Orders()
    sent(orders, Order(Command.GRASP, (0.03, 0.1, 20.0)))
    orders.heed(Message(Command.GRASP, PENDING))
    orders.put(move())
    assert orders.due(0.1) is None
    orders.stop()
    assert orders.due(0.2) is not None


@given(
    st.lists(
        st.one_of(
            st.sampled_from(["move", "grip", "stop", "due", "see"]),
            st.tuples(
                st.sampled_from([MOVE, STOP, Command.GRASP, Command.HOME]), st.integers(0, 30)
            ),
        ),
        max_size=40,
    )
)
def test_any_answers_leave_it_able_to_go_on(events: list[str | tuple[Command, int]]) -> None:
    orders, now = Orders(), 0.0
    for event in events:
        now += 0.1
        if isinstance(event, tuple):
            orders.heed(Message(*event))
        elif event == "stop":
            orders.stop()
        elif event == "see":
            seen(orders)
            orders.see(rests=True, now=now)
        elif event == "due":
            orders.due(now)
        else:
            orders.put(move() if event == "move" else Order(Command.GRASP, (0.0, 0.1, 20.0)))
    orders.stop()
    for _ in range(40):
        now += 0.3
        order = orders.due(now)
        if order is not None:
            orders.heed(Message(order.command, OK))
        seen(orders)
        orders.see(rests=True, now=now)
    assert orders.settled
    assert orders.running is None
