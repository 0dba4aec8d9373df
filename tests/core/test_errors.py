"""What is said of a device, for those who name it themselves."""

import pytest

from crtk_drivers.errors import ConnectionFailed, without_name

UR = "ur 10.0.0.2:30004"


@pytest.mark.parametrize(
    ("text", "where", "left"),
    [
        (f"{UR}: the stream ended", UR, "the stream ended"),
        (f"enable: {UR}: no power", UR, "enable: no power"),
        ("RTDE 10.0.0.2:30004: refused", UR, "RTDE: refused"),
        ("enable: 10.0.0.2:30004: refused", UR, "enable: refused"),
        ("dashboard 10.0.0.2:29999: refused", UR, "dashboard 10.0.0.2:29999: refused"),
        ("loopback loopback: gone", "loopback loopback", "gone"),
        ("gone", "rig", "gone"),
    ],
)
def test_a_device_is_not_named_twice(text: str, where: str, left: str) -> None:
    assert without_name(text, where) == left


def test_a_text_that_goes_on_has_no_remedy_in_it() -> None:
    error = ConnectionFailed("refused", where=UR, remedy="Is it on?")
    assert f"{error.statement}; going on" == f"{UR}: refused; going on"
    assert str(error) == f"{UR}: refused. Is it on?"
