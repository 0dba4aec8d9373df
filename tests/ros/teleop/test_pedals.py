"""Simulated pedals on ROS 2, as the dVRK tells them, and as teleoperation hears them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from sensor_msgs.msg import Joy

from crtk_driver_inputs import PLUGIN
from crtk_driver_inputs.config import InputsConfig
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.teleop import TopicPedal
from crtk_drivers.motion.teleop.machine import is_pressed
from crtk_drivers.motion.teleop.teleop_settings import PedalSettings
from crtk_drivers.session import Session
from crtk_sim_backends.inputs import SIM, RunningSim
from rigs.loopback_node import served
from rigs.waiting import eventually

FEET = "/footpedals"


@dataclass
class Feet:
    """Simulated pedals, and who listens to them."""

    sim: RunningSim
    link: Link

    def pedal(self, topic: str, button: int = 0) -> TopicPedal:
        return TopicPedal(self.link, PedalSettings(topic=topic, button=button))


@pytest.fixture(scope="module")
def feet() -> Iterator[Feet]:
    with SIM.spawn() as sim:
        config = InputsConfig(pedals={"clutch": 30, "coag": 48}, sample_timeout=1.0)
        session = Session(PLUGIN, PLUGIN.sim_config(config, sim))
        with served(session, FEET):
            link = Link("listener")
            link.start()
            try:
                yield Feet(sim, link)
            finally:
                link.close()


def test_a_pedal_is_heard_again_and_again_and_not_when_it_is_unplugged(feet: Feet) -> None:
    pedal, second = feet.pedal(f"{FEET}/clutch"), feet.pedal(f"{FEET}/joy", 1)

    def state(which: TopicPedal, pressed: bool) -> None:
        eventually(
            lambda: (heard := which.read()) is not None and heard.value is pressed, f"{pressed}"
        )

    state(pedal, False)
    feet.sim.control.inject("press", code=30)
    state(pedal, True)
    first = eventually(pedal.read, "it is known")
    eventually(
        lambda: (heard := pedal.read()) is not None and heard.since > first.since,
        "it is told again, though nothing changed",
    )
    state(second, False)
    feet.sim.control.inject("press", code=48)
    state(second, True)
    feet.sim.control.inject("disconnect")
    eventually(lambda: pedal.read() is None and second.read() is None, "not known, and not let go")
    feet.sim.control.clear()
    state(pedal, False)


def test_a_button_that_is_not_there_and_a_topic_of_nobody_are_not_heard(feet: Feet) -> None:
    clutch = feet.pedal(f"{FEET}/coag")
    eventually(lambda: clutch.read() is not None, "it is heard")
    assert feet.pedal(f"{FEET}/coag", 3).read() is None
    nobody = feet.pedal(f"{FEET}/camera").read()
    assert is_pressed(PedalSettings(topic=f"{FEET}/camera"), nobody, 0.0) is None


def test_two_who_tell_of_one_pedal_are_told_and_it_does_not_count(feet: Feet) -> None:
    topic = f"{FEET}/clutch"
    pedal = feet.pedal(topic)
    eventually(lambda: pedal.read() is not None, "it is heard")
    eventually(lambda: pedal.doubt == "", "only this one tells of it")
    other = Link("other_feet")
    try:
        other.node.create_publisher(Joy, topic, 10)
        eventually(lambda: pedal.doubt == f"{topic} is told by 2 publishers, not by one", "told")
    finally:
        other.close()
    eventually(lambda: pedal.doubt == "", "it has gone")


def test_a_pedal_of_which_an_old_message_comes_again_is_not_known() -> None:
    """It was let go since: a foot that nobody has on it couples nothing."""
    link, feet = Link("listener_of_late"), Link("late_feet")
    try:
        link.start()
        topic = "/late/engage"
        pedal = TopicPedal(link, PedalSettings(topic=topic, repeats=False))
        publisher = feet.node.create_publisher(Joy, topic, 10)
        eventually(lambda: publisher.get_subscription_count() == 1, "it is heard")
        eventually(lambda: link.publishers(topic) == 1, "it is found")

        def tell(pressed: bool, nanosec: int) -> None:
            message = Joy(buttons=[int(pressed)])
            message.header.stamp.sec, message.header.stamp.nanosec = 1000, nanosec
            publisher.publish(message)

        def state() -> bool | None:
            heard = pedal.read()
            return None if heard is None else heard.value

        tell(True, 100)
        eventually(lambda: state() is True, "it is pressed")
        tell(False, 200)
        eventually(lambda: state() is False, "it is let go")
        tell(True, 100)
        eventually(lambda: state() is None, "that was before")
        tell(True, 300)
        eventually(lambda: state() is True, "it is pressed anew")
    finally:
        feet.close()
        link.close()
