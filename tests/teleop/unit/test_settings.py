"""The table [teleop] of a lab file: all that it says is checked, and told with its line."""

from pathlib import Path

import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.lab_outline import load_teleop

DEVICES = """
[devices.hand]
plugin = "loopback"

[devices.arm]
plugin = "loopback"
namespace = "/bench/arm"
settings = { address = "arm" }
"""
TELEOP = """
[teleop]
leader = "hand"
follower = "arm"
[teleop.clutch]
topic = "/footpedals/clutch"
repeats = false
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "lab.toml"
    path.write_text(text)
    return path


def test_devices_of_the_lab_and_of_anybody(tmp_path):
    found = load_teleop(written(tmp_path, TELEOP + DEVICES))
    assert (found.leader, found.follower) == ("/hand", "/bench/arm")
    other = TELEOP.replace('"hand"', '"/MTMR"').replace('"arm"', '"/PSM1"')
    found = load_teleop(written(tmp_path, other))
    assert (found.leader, found.follower) == ("/MTMR", "/PSM1")


def test_the_table_does_no_harm_to_up(tmp_path):
    assert set(load_lab(written(tmp_path, TELEOP + DEVICES)).devices) == {"hand", "arm"}


@pytest.mark.parametrize("load", [load_lab, load_teleop])
def test_a_device_that_is_not_there(tmp_path, load):
    text = TELEOP.replace('"arm"', '"amr"') + DEVICES
    with pytest.raises(ConfigError, match="no device 'amr'") as caught:
        load(written(tmp_path, text))
    assert "lab.toml:4" in str(caught.value)
    assert "arm" in caught.value.remedy


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("scal = 1.0", "Did you mean 'teleop.scale'"),
        ("scale = 0", "greater than 0"),
        ("scale = nan", "finite"),
        ("rate = 10.0", "timeout: is shorter than two steps at this rate"),
        ('mode = "speed"', "position"),
        ("turn_scale = 2.0", "turn_scale: is of the mode rate and velocity"),
        ('mode = "rate"\norientation = "aligned"', "aligned is for the mode position"),
        ('orientation = "locked"\ntranslation = "locked"', "with both locked nothing follows"),
        ("[teleop.engage]", "give a topic or a key"),
        ('[teleop.engage]\nkey = "return"', "neither one letter or digit nor space"),
        ('[teleop.engage]\ntopic = "pedal"', "no full name"),
        ("[teleop.limits]\nspeed = 0.0", "greater than 0"),
    ],
)
def test_what_is_wrong_is_told(tmp_path, line, told):
    text = TELEOP.replace("[teleop.clutch]", f"{line}\n[teleop.clutch]")
    with pytest.raises(ConfigError) as caught:
        load_teleop(written(tmp_path, text + DEVICES))
    assert told in str(caught.value), str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (DEVICES, "teleop"),
        (TELEOP[: TELEOP.index("[teleop.clutch]")] + DEVICES, "something that uncouples them"),
        (TELEOP.replace('"arm"', '"hand"') + DEVICES, "cannot follow itself"),
        (TELEOP.replace('"arm"', '"/hand"') + DEVICES, "cannot follow itself"),
    ],
)
def test_what_is_missing_is_told(tmp_path, text, told):
    with pytest.raises(ConfigError) as caught:
        load_teleop(written(tmp_path, text))
    assert told in str(caught.value) + caught.value.remedy
