"""What `crtk-driver lab check` prints of what others say of themselves."""

import json
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from crtk_drivers.cli import lab_between
from crtk_drivers.client.lab_findings import View
from crtk_drivers.client.lab_look import Looked
from crtk_drivers.client.lab_look import _looked as looked_at
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.seen import Seen
from crtk_drivers.ros.presence import read_word
from rigs.lab_files import PAIR

pytestmark = pytest.mark.ros


def test_brackets_of_others_are_printed_as_they_are(tmp_path, monkeypatch, capsys):
    path = tmp_path / "lab.toml"
    path.write_text(PAIR)
    said = {"id": "a", "driver": "[/x]", "host": "[/red]", "pid": 1, "started": 1}
    word = read_word(json.dumps({**said, "established": True, "there": True}))
    seen = Seen("camera", True, "ENABLED", host="[/red]", offset=1.0, uncertainty=0.001)
    view = View(
        {"arm": Looked(Seen("arm", False)), "camera": Looked(seen, (word, word), "[/9]")},
        42,
        "1.0",
        "1.3.0",
    )
    monkeypatch.setattr(lab_between, "_view", lambda _: view)
    assert lab_between.check_between(load_lab(path, machine="control")) == 1
    printed = capsys.readouterr().out
    assert "[/red]" in printed
    assert "[/9]" in printed


def test_versions_have_no_control_characters():
    device = SimpleNamespace(seen=lambda: Seen("arm", True), drivers=tuple)
    manifest = {"driver_version": "\x1b[2J1.0", "crtk_version": "1\n3"}
    found = looked_at(device, SimpleNamespace(look=lambda: None, manifest=manifest))
    assert (found.driver_version, found.crtk_version) == ("[2J1.0", "13")
