"""Commands on one machine of a lab: each takes the share of that machine, and says what others have."""

import pytest

from crtk_drivers.cli import main, up_command
from crtk_drivers.labs.bench.results import read_run
from crtk_drivers.labs.supervisor import Supervisor
from rigs.lab_files import PAIR

TWO = f"""{PAIR}
[programs.teleop]
command = ["true"]
after = ["arm", "camera"]

[programs.logger]
command = ["nowhere-at-all", "--all"]
machine = "laptop"
"""
DOMAIN = 'environment = { ROS_DOMAIN_ID = 42, ROS_AUTOMATIC_DISCOVERY_RANGE = "SUBNET" }\n'


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Carries out a command on a lab; returns the exit code, and its words with one space between them."""
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("socket.gethostname", lambda: "control.lab.example")

    def run(*words, text=TWO):
        (tmp_path / "lab.toml").write_text(text)
        code = main([each if each != "LAB" else "lab.toml" for each in words])
        said = capsys.readouterr()
        return code, " ".join((said.out + said.err).split())

    return run


def test_check_shows_what_each_machine_starts(command):
    code, said = command("lab", "check", "LAB", "--no-ros", text=DOMAIN + TWO)
    assert code == 0, said
    assert "machine driver namespace at after arm control loopback /arm " in said
    assert "camera tracking of-tracking /camera teleop control true arm, camera" in said
    assert "logger laptop nowhere-at-all --all" in said
    assert "To be checked there: camera on tracking" in said
    assert "decides its domain" not in said
    assert "see each other" not in said


def test_check_tells_what_keeps_machines_apart(command):
    local = 'environment = { ROS_AUTOMATIC_DISCOVERY_RANGE = "LOCALHOST" }\n'
    code, said = command("lab", "check", "LAB", "--no-ros", text=local + TWO)
    assert code == 1, said
    assert "the machines of this lab cannot see each other" in said
    assert "the shell of each machine decides its domain" in said


def test_check_on_a_foreign_machine_checks_all_settings(command, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "elsewhere")
    real = TWO.replace("of-tracking", "ati-netft")
    code, said = command("lab", "check", "LAB", "--no-ros", "--sim", text=real)
    assert code == 0, said
    assert "this machine is called 'elsewhere', and the lab file names control, tracking" in said
    assert "camera tracking ati-netft /camera a simulator" in said
    assert "libraries and commands are on the machines of the lab" in said
    code, said = command("lab", "check", "LAB", "--no-ros", text=real)
    assert code == 2, "the other machine's address is missing"
    assert "host" in said


def test_check_of_another_machine_is_typed(command):
    code, said = command("lab", "check", "LAB", "--no-ros", "--machine", "laptop")
    assert code == 2
    assert "there is no program 'nowhere-at-all'" in said


def test_the_bench_leaves_out_what_others_have(command, tmp_path):
    code, said = command("bench", "LAB", "--only", "T3", "--out", "run")
    assert "left out: camera on tracking; this is control" in said
    assert [device.name for device in read_run(tmp_path / "run").devices] == ["arm"], (code, said)


@pytest.mark.parametrize("words", [("bench", "LAB"), ("up", "LAB", "--systemd", "-")], ids=" ".join)
def test_a_machine_without_devices_is_told(command, words):
    code, said = command(*words, "--machine", "laptop")
    assert code == 2
    assert (
        "laptop starts no device of this lab; others start arm on control; camera on track" in said
    )


def test_units_of_a_share_say_so_and_what_keeps_them_apart(command, monkeypatch):
    monkeypatch.setattr(up_command, "not_working", lambda *_: "")
    code, said = command("up", "LAB", "--systemd", "-")
    assert code == 0, said
    assert "crtk-pair-arm.service" in said
    assert "crtk-pair-camera.service" not in said
    assert "These are the units of control. Others start camera on tracking." in said
    assert "cannot see each other: ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST" in said
    assert (
        "cannot see each other" not in command("up", "LAB", "--systemd", "-", text=DOMAIN + TWO)[1]
    )


@pytest.mark.parametrize("machine", ["", "control"])
def test_up_starts_its_share_and_says_what_others_have(command, monkeypatch, machine):
    supervised = []

    class Ended(Supervisor):
        is_over = True

        def __init__(self, *arguments):
            super().__init__(*arguments)
            supervised.append(self)

    monkeypatch.setattr(up_command, "Supervisor", Ended)
    _, said = command("up", "LAB", "--logs", "logs", *(("--machine", machine) if machine else ()))
    (supervisor,) = supervised
    assert [child.name for child in supervisor.children] == ["arm", "teleop"]
    assert "pair: this is control; others start camera on tracking" in said
    assert "the shell of each machine decides its domain" in said


def test_a_run_is_judged_again_without_the_drivers_of_others(command):
    command("bench", "LAB", "--only", "T3", "--out", "run")
    code, said = command("bench", "again", "run")
    assert "Judged anew with the bounds of" in said, (code, said)
