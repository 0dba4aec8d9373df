"""Defects of single simulated servos, without a wire."""

import pytest

from crtk_sim_backends.dynamixel.bus import make_servos
from crtk_sim_backends.dynamixel.config import parse_servos
from crtk_sim_backends.dynamixel.defects import ServoDefects
from crtk_sim_backends.dynamixel.modern import ModernServo


@pytest.mark.parametrize(("ignores", "trips"), [(0, True), (1, False)])
def test_a_bus_watchdog_may_be_ignored(ignores: int, trips: bool) -> None:
    (servo,) = make_servos(
        parse_servos("1:xm430-w350"), 1_000_000, 0, (ServoDefects(ignores_watchdog=ignores),)
    )
    assert isinstance(servo, ModernServo)
    for name, value in (("torque_enable", 1), ("bus_watchdog", 5)):
        register = servo.table[name]
        assert not servo.write(register.address, register.encode(value), 0.0)
    servo.advance(1.0)
    assert (servo["bus_watchdog"] == -1) is trips


@pytest.mark.parametrize(
    ("model", "name"), [("ax-12a", "present_position"), ("xl430-w250", "present_position")]
)
def test_what_a_servo_measures_is_off(model: str, name: str) -> None:
    counts = {}
    for noise in (0.0, 0.1):
        (servo,) = make_servos(
            parse_servos(f"1:{model}"), 1_000_000, 0, (ServoDefects(position_noise=noise),)
        )
        found = set()
        for n in range(20):
            servo.refresh(0.01 * n)
            register = servo.table["present_position"]
            found.add(register.decode(servo.memory[register.address : register.end]))
        counts[noise] = len(found)
    assert counts[0.0] == 1
    assert counts[0.1] > 10
