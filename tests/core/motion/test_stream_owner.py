"""A stream has an owner: two clients that stream are not both obeyed."""

from collections.abc import Iterator

import pytest

from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig
from rigs.scripted_engine import Rig, jf, jp, jv
from rigs.waiting import LONG

FIRST, SECOND = Client("the first"), Client("the second")
TIMEOUT, SLOW_TIMEOUT = 0.1, 0.5


@pytest.fixture
def rig() -> Rig:
    return Rig(EngineOptions(stream_timeout=TIMEOUT, interpolate_timeout=SLOW_TIMEOUT)).enabled()


def owned(rig: Rig, name: str, value: object = None, client: Client = SECOND) -> str:
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit(name, value, client=client)
    assert caught.value.reason is Reason.STREAM_OWNED
    return str(caught.value)


def test_of_two_clients_that_alternate_only_the_first_is_obeyed(rig: Rig) -> None:
    for step in range(1, 30):
        rig.engine.submit("servo_jp", jp(0.001 * step, 0.0), client=FIRST)
        rig.cycle()
        assert "the first streams servo_jp" in owned(rig, "servo_jp", jp(-0.001 * step, 0.0))
        rig.cycle()
    assert all(setpoint.values[0] > 0.0 for setpoint in rig.written)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("servo_jv", jv(0.1, 0.0)),
        ("servo_jr", jp(0.001, 0.0)),
        ("interpolate_jp", jp(0.1, 0.0)),
        ("move_jp", jp(0.5, 0.0)),
        ("move_jr", jp(0.5, 0.0)),
        ("free", None),
        ("servo_jp", jp(0.9, 0.0)),  # too large a step: whose it is comes first
        ("servo_jp", jp(float("nan"), 0.0)),
    ],
)
def test_nobody_else_takes_a_stream_over(rig: Rig, name: str, value: object) -> None:
    rig.engine.submit("servo_jp", jp(0.001, 0.0), client=FIRST)
    rig.cycle()
    owned(rig, name, value)
    rig.engine.submit("servo_jp", jp(0.002, 0.0), client=FIRST)
    rig.cycle()
    assert rig.written[-1].values[0] == 0.002


def test_it_is_free_again_after_the_silence_of_its_timeout(rig: Rig) -> None:
    rig.engine.submit("servo_jp", jp(0.001, 0.0), client=FIRST)
    rig.cycle(count=9)
    owned(rig, "servo_jp", jp(0.0, 0.0))
    rig.cycle(count=2)
    rig.engine.submit("servo_jp", jp(0.0, 0.0), client=SECOND)
    owned(rig, "servo_jp", jp(0.0, 0.0), FIRST)


def test_an_interpolated_stream_is_owned_for_its_own_timeout(rig: Rig) -> None:
    rig.engine.submit("interpolate_jp", jp(0.01, 0.0), client=FIRST)
    rig.cycle(count=45)
    owned(rig, "servo_jp", jp(0.0, 0.0))
    rig.cycle(count=6)
    rig.engine.submit("interpolate_jp", jp(0.0, 0.0), client=SECOND)


def test_what_is_refused_does_not_prolong_it(rig: Rig) -> None:
    rig.engine.submit("servo_jp", jp(0.0, 0.0), client=FIRST)
    for _ in range(8):
        rig.cycle()
        with pytest.raises(CommandRefused):
            rig.engine.submit("servo_jp", jp(float("inf"), 0.0), client=FIRST)
        with pytest.raises(CommandRefused):
            rig.engine.submit("servo_jp", jp(0.0, 0.0), client=SECOND)
    rig.cycle(count=3)
    rig.engine.submit("servo_jp", jp(0.0, 0.0), client=SECOND)


@pytest.mark.parametrize(("name", "value"), [("move_jp", jp(0.1, 0.0)), ("hold", None)])
def test_its_owner_ends_it_by_a_move_or_hold(rig: Rig, name: str, value: object) -> None:
    rig.engine.submit("servo_jp", jp(0.001, 0.0), client=FIRST)
    rig.cycle()
    rig.engine.submit(name, value, client=FIRST)
    rig.cycle()
    rig.engine.submit("servo_jf", jf(0.0, 0.0), client=SECOND)


def test_hold_is_anybodys_and_lasts(rig: Rig) -> None:
    """Who goes on sending is not obeyed again until he has noticed."""
    rig.engine.submit("servo_jv", jv(0.5, 0.0), client=FIRST)
    rig.cycle()
    rig.engine.submit("hold", client=SECOND)
    rig.cycle()
    for _ in range(30):
        text = owned(rig, "servo_jv", jv(0.5, 0.0), FIRST)
        assert "the second ended this stream with hold" in text
    assert rig.device.calls[-1] == "stop"
    rig.cycle(count=11)
    rig.engine.submit("servo_jv", jv(0.5, 0.0), client=FIRST)


def test_after_hold_of_another_he_may_move_and_stream(rig: Rig) -> None:
    for name, value in (("move_jp", jp(0.1, 0.0)), ("servo_jp", jp(0.0, 0.0))):
        rig.engine.submit("servo_jp", jp(0.0, 0.0), client=FIRST)
        rig.cycle()
        rig.engine.submit("hold", client=SECOND)
        rig.engine.submit(name, value, client=SECOND)
        owned(rig, "servo_jp", jp(0.0, 0.0), FIRST)
        rig.engine.submit("hold", client=SECOND)
        rig.cycle(count=11)


def test_nobody_owns_a_stream_that_ended_with_enabled(rig: Rig) -> None:
    rig.engine.submit("servo_jp", jp(0.0, 0.0), client=FIRST)
    rig.command("pause")
    rig.command("resume")
    rig.engine.submit("servo_jp", jp(0.0, 0.0), client=SECOND)


@pytest.fixture
def two() -> Iterator[tuple[LocalDevice, LocalDevice]]:
    session = Session(PLUGIN, LoopbackConfig(stream_timeout=5.0))
    with LocalDevice(session) as one, LocalDevice(session) as other:
        session.start()
        one.measured_js(wait=LONG)
        one.enable()
        yield one, other


def test_handles_in_one_process_are_clients(two: tuple[LocalDevice, LocalDevice]) -> None:
    one, other = two
    one.servo_jp([0.0] * 4)
    for command in (other.servo_jp, other.move_jp, other.interpolate_jp):
        with pytest.raises(CommandRefused) as caught:
            command([0.0] * 4)
        assert caught.value.reason is Reason.STREAM_OWNED
    one.servo_jp([0.0] * 4)
    other.hold()
    other.move_jp([0.01, 0.0, 0.0, 0.0]).wait(LONG)
    other.servo_jp([0.01, 0.0, 0.0, 0.0])
