"""The hand between two answers of its link: its procedures are stepped, and told what was read."""

import time
from dataclasses import replace

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.device import RobotiqHand
from crtk_driver_robotiq.registers import Activation, Contact, Status
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Mode
from crtk_drivers.kit.gripping import Doing
from crtk_drivers.kit.modbus_link import Answer
from crtk_drivers.samples import Stamp

RESET = Status(
    activated=False,
    goes=False,
    activation=Activation.RESET,
    contact=Contact.MOVING,
    fault=0,
    controller_fault=0,
    requested=0,
    position=3,
    current=0.0,
)


def made() -> RobotiqHand:
    return RobotiqHand(load(RobotiqConfig, from_values({"link": "modbus", "host": "127.0.0.1"})))


def test_once_it_is_activated_a_stop_resets_nothing() -> None:
    """Nor where no answer comes between the end of the activation and the stop."""
    hand = made()

    def read(status: Status) -> None:
        hand._keep(Answer(status, Stamp.now(), hand._pending))

    read(RESET)
    steps = hand.make_ready(may_hold=False)
    next(steps)
    read(RESET)
    next(steps)
    read(replace(RESET, activated=True, activation=Activation.RUNNING))
    next(steps)
    assert not hand.rests
    read(replace(RESET, activated=True, activation=Activation.DONE))
    deadline = time.monotonic() + 5.0
    while next(steps, "ended") != "ended":
        assert time.monotonic() < deadline
    hand.halt(aside=False)
    assert hand.is_told


def test_what_was_asked_for_soon_after_a_command_is_not_believed_for_being_read_late() -> None:
    """It may be about the command before, however long the driver was held up as it read it."""
    hand, late = made(), 1.0
    holds = replace(RESET, activated=True, goes=True, activation=Activation.DONE)
    holds = replace(holds, contact=Contact.WHILE_CLOSING)
    hand._keep(Answer(holds, Stamp.now(), None))
    hand.go(hand.order(Mode.JOINT_POSITION, 0.05, 1.0), at_once=True)
    assert hand._pending is not None
    told = replace(holds, requested=hand._pending.position)
    hand._keep(Answer(told, Stamp.now(), hand._pending))
    hand._grip._since -= late
    now = Stamp.now()
    asked = Stamp(now.wall_ns - int(late * 1e9), now.monotonic - late)
    hand._keep(Answer(told, asked, None))
    assert hand.doing is Doing.MOVING
    hand._keep(Answer(told, now, None))
    assert hand.doing is Doing.HOLDS
