"""The mailbox between clients and the I/O thread."""

import threading

import pytest

from crtk_drivers.device import Goal, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, rotvec_from_quaternion
from crtk_drivers.motion.arbiter import Arbiter, Order
from crtk_drivers.motion.move import Move
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import Pose, vector


def position(*values: float) -> Order:
    return Order("servo_jp", Setpoint(Mode.JOINT_POSITION, vector(values)))


def increment(*values: float) -> Order:
    return Order("servo_jr", increment=vector(values))


def move() -> Order:
    return Order("move_jp", goal=Goal(joints=vector((0.0,))), move=Move("move_jp"))


def test_it_is_one_deep_and_gives_each_order_once() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    assert arbiter.take() is None
    arbiter.put(position(1.0), 0.0)
    newest = position(2.0)
    arbiter.put(newest, 0.0)
    assert arbiter.take() is newest
    assert arbiter.take() is None


def test_increments_are_summed_and_start_anew_once_taken() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    for _ in range(3):
        arbiter.put(increment(0.5, -1.0), 0.0)
    order = arbiter.take()
    assert order is not None
    assert order.increment.tolist() == [1.5, -3.0]
    arbiter.put(increment(0.5, 0.0), 0.0)
    order = arbiter.take()
    assert order is not None
    assert order.increment.tolist() == [0.5, 0.0]


def test_an_increment_onto_a_waiting_position_moves_that() -> None:
    arbiter = Arbiter(EngineOptions(mode_switch_dwell=0.0), "here")
    arbiter.put(position(1.0, 2.0), 0.0)
    arbiter.put(increment(0.5, 0.5), 1.0)
    order = arbiter.take()
    assert order is not None
    assert order.setpoint is not None
    assert order.setpoint.values.tolist() == [1.5, 2.5]
    assert not order.increment.size


def displacement(position: tuple[float, ...], angle: float) -> Order:
    turn = quaternion_from_rotvec(vector((0.0, 0.0, angle)))
    return Order("servo_cr", displacement=Pose(vector(position), turn))


def test_displacements_are_summed_along_the_axes_of_the_base() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    for _ in range(3):
        arbiter.put(displacement((0.1, -0.2, 0.0), 0.5), 0.0)
    order = arbiter.take()
    assert order is not None
    assert order.displacement is not None
    assert order.displacement.position == pytest.approx([0.3, -0.6, 0.0])
    assert rotvec_from_quaternion(order.displacement.orientation) == pytest.approx([0, 0, 1.5])


def test_no_increment_is_lost_between_two_threads() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    ready, total = threading.Event(), [0.0]

    def send() -> None:
        ready.wait()
        for _ in range(2000):
            arbiter.put(increment(1.0), 0.0)

    clients = [threading.Thread(target=send) for _ in range(3)]
    for client in clients:
        client.start()
    ready.set()
    while any(client.is_alive() for client in clients):
        order = arbiter.take()
        total[0] += order.increment[0] if order else 0.0
    order = arbiter.take()
    assert total[0] + (order.increment[0] if order else 0.0) == 6000.0


def test_a_move_that_is_replaced_or_forgotten_is_handed_back() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    first, second = move(), move()
    assert arbiter.put(first, 0.0) is None
    assert arbiter.waiting_move is not None
    assert arbiter.put(second, 0.0) is first.move
    assert arbiter.clear() is second.move
    assert arbiter.waiting_move is None
    assert arbiter.clear() is None


def test_another_stream_takes_over_after_the_dwell_only() -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    arbiter.put(position(0.0), 10.0)
    with pytest.raises(CommandRefused, match="a stream of servo_jp is running") as caught:
        arbiter.put(increment(0.0), 10.09)
    assert caught.value.reason is Reason.MODE_SWITCH
    order = arbiter.take()
    assert order is not None
    assert order.name == "servo_jp", "the refused one left the mailbox as it was"
    arbiter.put(position(0.0), 10.09)
    with pytest.raises(CommandRefused):
        arbiter.put(increment(0.0), 10.18)
    arbiter.put(increment(0.0), 10.2)
    with pytest.raises(CommandRefused):
        arbiter.put(position(0.0), 10.2)


@pytest.mark.parametrize("other", [Order("hold"), Order("free"), move()])
def test_what_is_no_stream_ends_one_at_once(other: Order) -> None:
    arbiter = Arbiter(EngineOptions(), "here")
    arbiter.put(position(0.0), 0.0)
    arbiter.put(other, 0.0)
    arbiter.put(increment(0.0), 0.0)
