"""Over DDS: free drive ends when the node that asked for it leaves, or must ask again and does not."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty

from crtk_drivers.device import Steps
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.senders import Sender
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import Rig, rig_of
from rigs.waiting import eventually


class FreeDevice(LoopbackDevice):
    """Says whether it is let go, and whether it ever was."""

    is_free = was_free = False

    def free(self) -> Steps:
        self.is_free = self.was_free = True
        yield

    def stop(self) -> None:
        super().stop()
        self.is_free = False


PLUGIN = DevicePlugin("loopback", "can be free", LoopbackConfig, FreeDevice)


class Pendant:
    """A node in a DDS participant of its own that lets go of the device."""

    def __init__(self, namespace: str) -> None:
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("pendant", context=self.context, enable_rosout=False)
        self._publisher = self.node.create_publisher(Empty, f"{namespace}/free", 10)
        eventually(lambda: self._publisher.get_subscription_count() == 1, "they have met")

    def let_go(self) -> None:
        self._publisher.publish(Empty())

    def leave(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()


def device_of(rig: Rig) -> FreeDevice:
    assert isinstance(rig.device, FreeDevice)
    return rig.device


def is_free(rig: Rig) -> bool:
    return device_of(rig).is_free


def test_free_drive_ends_when_its_node_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[Sender] = []
    look = Sender.look

    def counted(sender: Sender) -> None:
        look(sender)
        looks.append(sender)

    monkeypatch.setattr(Sender, "look", counted)
    with rig_of("/tied", plugin=PLUGIN, on_client_gone="hold") as rig:
        rig.client.reach("enable", "ENABLED")
        pendant = Pendant("/tied")
        pendant.let_go()
        eventually(lambda: is_free(rig), "it is free")
        looked = len(looks)
        eventually(lambda: len(looks) > looked + 4, "the graph was asked")
        cycles = rig.session.engine.health().cycles
        eventually(
            lambda: rig.session.engine.health().cycles > cycles + 4, "it knows what was answered"
        )
        assert is_free(rig)
        pendant.leave()
        eventually(lambda: not is_free(rig), "it holds")
        assert rig.client.state.state == "ENABLED"


def test_free_drive_ends_when_it_is_not_asked_for_again() -> None:
    with rig_of("/asked", plugin=PLUGIN, free_timeout=1.0) as rig:
        rig.client.reach("enable", "ENABLED")
        pendant = Pendant("/asked")
        pendant.let_go()
        eventually(lambda: device_of(rig).was_free, "it was free")
        eventually(lambda: not is_free(rig), "it holds")
        pendant.leave()
