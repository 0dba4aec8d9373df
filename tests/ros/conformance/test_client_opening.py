"""CLI-1 over ROS: a client of a process of its own opens a device as the official one's users do."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from crtk_drivers.client.conformance.findings import Finding, Verdict
from crtk_drivers.client.conformance.probe import client_opening
from crtk_drivers.client.conformance.probe.examining import examine
from rigs.loopback_node import Rig
from rigs.waiting import LONG

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,  # test_trials.test_the_official_client_alone_decides is the quick brother
]

ALL = "enable, home, measured_jp, move_jp(...).wait() there, move_jp(...).wait() back worked"


def found(rig: Rig) -> Finding:
    outcome = examine(rig.client.namespace, ["CLI-1"], 0.5, LONG, may_move=True)
    assert outcome.ended == ""
    (result,) = outcome.results
    return result.finding


def test_without_it_the_layer_does_the_same_and_it_stays_open(rig: Rig) -> None:
    told = found(rig)
    assert told.verdict is Verdict.UNDETERMINED
    assert told.text.startswith("the official client (crtk, with PyKDL) is not installed here")
    assert told.text.endswith(ALL)
    assert rig.session.engine.status.state == "DISABLED"


def test_where_it_is_installed_it_decides(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of this name here is the layer; a device that does what the client waits for conforms."""
    package = tmp_path / "crtk"
    package.mkdir()
    (package / "__init__.py").write_text("from crtk_drivers.client.compat.v1_4 import *\n")
    (package / "wait_move_handle.py").write_text("")
    (tmp_path / "PyKDL.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    monkeypatch.setenv("PYTHONPATH", path)
    assert found(rig) == Finding(Verdict.CONFORMS, ALL)
    (package / "wait_move_handle.py").unlink()  # PyPI has another package of that name
    assert not client_opening._is_installed()
