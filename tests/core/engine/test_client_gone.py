"""Free drive and gravity compensation end when the client that asked for them has gone."""

from typing import Any

import pytest

from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.samples import Flag
from rigs.scripted_engine import Rig, jp, two_joints


class Leaving(Client):
    def __init__(self, name: str = "a pendant") -> None:
        super().__init__(name)
        self.stays = True

    @property
    def is_there(self) -> bool:
        return self.stays


def freed(client: Client, **options: Any) -> Rig:
    rig = Rig(EngineOptions(**options)).enabled()
    rig.engine.submit("free", client=client)
    rig.cycle(count=2)
    assert rig.device.calls[-1] == "free"
    return rig


def test_free_drive_ends_when_its_client_has_gone() -> None:
    client = Leaving()
    rig = freed(client, on_client_gone="hold")
    rig.cycle(count=50)
    assert rig.device.calls[-1] == "free"
    client.stays = False
    rig.cycle()
    assert rig.device.calls[-1] == "stop"
    assert rig.told.warnings == ["free: a pendant has gone; the device holds"]
    stops = rig.device.calls.count("stop")
    rig.cycle(count=10)
    assert rig.device.calls.count("stop") == stops


def test_it_goes_on_unless_the_user_wants_that() -> None:
    client = Leaving()
    rig = freed(client)
    client.stays = False
    rig.cycle(count=1000)
    assert rig.device.calls[-1] == "free"


def test_it_is_tied_to_who_asked_last() -> None:
    first, second = Leaving(), Leaving("another")
    rig = freed(first, on_client_gone="hold")
    rig.engine.submit("free", client=second)
    first.stays = False
    rig.cycle(count=10)
    assert rig.device.calls.count("free") == 1, "who is free is not freed anew"
    second.stays = False
    rig.cycle()
    assert rig.told.warnings == ["free: another has gone; the device holds"]


def test_it_ends_when_it_is_not_asked_for_again() -> None:
    rig = freed(Leaving(), free_timeout=0.5)
    for _ in range(10):
        rig.cycle(count=40)
        rig.engine.submit("free", client=Leaving())
    assert rig.device.calls.count("free") == 1
    rig.cycle(count=49)
    assert rig.device.calls[-1] == "free"
    rig.cycle(count=3)
    assert rig.device.calls[-1] == "stop"
    assert "not asked for again in 0.5 s" in rig.told.warnings[-1]
    rig.engine.submit("free", client=Leaving())
    rig.cycle(count=3)
    assert rig.device.calls[-1] == "free"


@pytest.mark.parametrize("gone", [False, True])
def test_what_ended_free_drive_is_left_alone(gone: bool) -> None:
    client = Leaving()
    rig = freed(client, on_client_gone="hold", free_timeout=0.5)
    move = rig.engine.submit("move_jp", jp(0.5, 0.0), client=Leaving())
    client.stays = not gone
    rig.cycle(count=300)
    assert move is not None
    move.wait(0.0)
    assert not rig.told.warnings
    assert rig.written[-1].values[0] == pytest.approx(0.5)


class CarryingRig(Rig):
    """A device that notes whether it carries its own weight."""

    def __init__(self, **options: Any) -> None:
        super().__init__(EngineOptions(**options), two_joints(has_gravity_compensation=True))
        self.carried: list[bool] = []
        self.device.use_gravity_compensation = self.carried.append  # type: ignore[method-assign]


def test_gravity_compensation_ends_when_its_client_has_gone() -> None:
    rig, client = CarryingRig(on_client_gone="hold"), Leaving()
    rig.enabled()
    rig.engine.submit("use_gravity_compensation", Flag(True), client=client)
    rig.cycle(count=10)
    client.stays = False
    rig.cycle(count=10)
    assert rig.carried == [True, False]
    assert rig.told.warnings == ["use_gravity_compensation: a pendant has gone; it is off"]


def test_the_device_holds_before_it_carries_its_weight_no_more() -> None:
    rig, client = CarryingRig(on_client_gone="hold"), Leaving()
    rig.enabled()
    rig.engine.submit("use_gravity_compensation", Flag(True), client=client)
    rig.engine.submit("free", client=client)
    rig.cycle()
    client.stays = False
    rig.cycle()
    assert rig.device.calls[-1] == "stop"
    assert rig.carried == [True]
    rig.cycle()
    assert rig.carried == [True, False]


def test_gravity_compensation_that_was_switched_off_is_left_alone() -> None:
    rig, client = CarryingRig(on_client_gone="hold"), Leaving()
    rig.enabled()
    for on in (True, False):
        rig.engine.submit("use_gravity_compensation", Flag(on), client=client)
        rig.cycle()
    client.stays = False
    rig.cycle(count=10)
    assert rig.carried == [True, False]
    assert not rig.told.warnings


def test_gravity_compensation_is_not_switched_on_by_a_reconnection() -> None:
    """What was asked for while the link was lost was carried out whenever it came back."""
    rig = CarryingRig().enabled()
    rig.engine.submit("use_gravity_compensation", Flag(True))
    rig.disconnect("the link is gone")
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("use_gravity_compensation", Flag(True))
    assert caught.value.reason is Reason.NOT_CONNECTED
    rig.connect()
    rig.cycle(count=5)
    assert rig.carried == []
    rig.engine.submit("use_gravity_compensation", Flag(True))
    rig.disconnect("the link is gone")
    rig.engine.submit("use_gravity_compensation", Flag(False))
    rig.connect()
    rig.cycle()
    assert rig.carried == [False], "off is always right"
