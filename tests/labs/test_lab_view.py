"""What `crtk-driver up` shows of devices on other machines."""

import logging
from types import SimpleNamespace

import pytest
from rich.console import Console

from crtk_drivers.cli.lab_view import ShownLab, table_of
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.child import Phase
from crtk_drivers.labs.seen import Seen
from crtk_drivers.labs.supervisor import Supervisor
from rigs.lab_files import PAIR

IDLE = Seen("camera", True, "DISABLED", measures=True, offset=0.001, uncertainty=0.0003)
AHEAD = Seen("camera", True, "ENABLED", measures=True, offset=0.0124, uncertainty=0.0003)


@pytest.fixture
def lab(tmp_path):
    """Of the machine control: its supervisor, and what sets how the device elsewhere is seen."""
    path = tmp_path / "lab.toml"
    path.write_text(PAIR)
    supervisor = Supervisor(load_lab(path, machine="control"), tmp_path / "logs")
    observer = SimpleNamespace(seen=lambda name: None, why="ended by SIGKILL", phase=Phase.RUNNING)
    supervisor.observer = observer

    def see(seen):
        observer.seen = {"camera": seen}.get

    return supervisor, see


@pytest.mark.parametrize(
    ("seen", "words", "clock"),
    [
        (None, "not known ended by SIGKILL", ""),
        (Seen("camera", False), "not seen yet", ""),
        (Seen("camera", False, ago=12.4), "not seen for 12 s", ""),
        (Seen("camera", True), "seen does not measure", ""),
        (IDLE, "DISABLED", ""),
        (
            Seen("camera", True, "FAULT", "no link", offset=1.0),
            "FAULT no link",
            "+1000 ms",
        ),
        (Seen("camera", True, "of-another-version", measures=True), "of-another-version", ""),
        (AHEAD, "ENABLED", "+12 ms"),
        (Seen("camera", True, "ENABLED", measures=True, offset=-3600.0), "ENABLED", "-3600 s"),
    ],
)
def test_a_device_of_another_machine_has_its_row(lab, seen, words, clock):
    supervisor, see = lab
    see(seen)
    console = Console(width=200)
    with console.capture() as said:
        console.print(table_of(supervisor))
    rows = [" ".join(line.split()) for line in said.get().splitlines()]
    assert rows[0] == "pair on control"
    assert rows[2:] == [
        "arm /arm waiting",
        f"on tracking clock {clock}" if clock else "on tracking",
        f"camera /camera {words}",
    ]


def test_a_change_elsewhere_is_logged_once(lab, caplog):
    caplog.set_level(logging.INFO)
    supervisor, see = lab
    show = ShownLab(supervisor, None)
    for seen in (None, Seen("camera", False), Seen("camera", False), IDLE, IDLE, AHEAD, AHEAD):
        see(seen)
        show()
    for ago in (1.0, 2.0):
        see(Seen("camera", False, ago=ago))
        show()
    assert caplog.messages[:2] == [
        "camera on tracking: not seen yet",
        "camera on tracking: DISABLED",
    ]
    warning = caplog.messages[3]
    assert warning.startswith("the clock of tracking is not that of this machine (clock +12 ms)")
    assert caplog.messages[2::2] == ["camera on tracking: ENABLED", "camera on tracking: not seen"]
    assert len(caplog.messages) == 5
    supervisor.observer.phase = Phase.ENDED
    see(None)
    show()
    assert len(caplog.messages) == 5, "its end is no news of the device"
