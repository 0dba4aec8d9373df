"""``crtk-driver conform``: its exit codes, what it prints and writes, and how an interrupt ends it."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from crtk_drivers.client.conformance.probe import examining
from crtk_drivers.client.ros_link import Link
from rigs.loopback_node import Rig
from rigs.programs import COMMAND, Start
from rigs.waiting import LONG, eventually

Run = Callable[..., tuple[int, str, str]]
MAIN = "import sys; from crtk_drivers.cli import main; sys.exit(main())"
QUICK = ("--listen", "0.5", "--timeout", str(LONG))


def test_it_prints_what_was_found_and_writes_a_report(
    rig: Rig, run_far: Run, tmp_path: Path
) -> None:
    chosen = ("--only", "NAM,TYP,QOS-1,MOV-4,CLI-1")
    code, out, _ = run_far("conform", rig.client.namespace, *QUICK, *chosen, "--out", str(tmp_path))
    assert code == 0, out
    assert "NAM-1" in out
    assert "UNDETERMINED" in out
    words = " ".join(out.split())
    assert "needs --may-move: MOV-4, CLI-1" in words
    assert "conforms to CRTK 1.3, names, transport and data" in words
    data = json.loads((tmp_path / "conformance.json").read_text())
    assert {each["id"]: each["verdict"] for each in data["results"]}["NAM-1"] == "CONFORMS"
    assert (tmp_path / "conformance.html").read_text().startswith("<!doctype html>")
    assert (tmp_path / "junit.xml").is_file()


def test_without_a_device_nothing_could_be_judged(
    rig: Rig, run_far: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A node that has found who is there already: a new one may take longer than it looks.
    monkeypatch.setattr(examining, "Link", lambda name: Link(name, node=rig.client.node))
    code, _, err = run_far("conform", "/nobody", "--listen", "0.5", "--timeout", "0.5")
    assert code == 3
    assert "no CRTK device in the namespace /nobody" in err
    assert rig.client.namespace in err


def test_what_cannot_be_used_is_told_at_once(run_far: Run, tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text("stroke = 5.0\n")
    for arguments, hint in (
        ((), "which device?"),
        (("/arm", "--only", "QOS-77"), "there is no clause QOS-77"),
        (("arm",), "is not a namespace"),
        (("/arm", "--expect", str(tmp_path / "far.toml")), "far.toml:1"),
        (("/arm", "--expect", str(tmp_path / "none.toml")), "none.toml"),
    ):
        code, _, err = run_far("conform", *arguments)
        assert (code, hint in " ".join(err.split())) == (2, True), err


def test_the_clauses_are_listed_without_a_device(run_far: Run) -> None:
    code, out, _ = run_far("conform", "--list")
    assert code == 0
    assert "NAM-1" in out


@pytest.mark.real_time  # what a program prints
def test_an_interrupt_holds_the_device_and_leaves_it_as_it_was(start: Start, rig: Rig) -> None:
    engine = rig.session.engine
    words = (
        "conform",
        rig.client.namespace,
        *QUICK,
        "--may-move",
        "--only",
        "MOV-22,MOV-8,SET-1",
    )
    pipe = subprocess.PIPE
    with start(COMMAND, *words, stdout=pipe, stderr=pipe) as process:
        try:
            eventually(lambda: engine.status.state == "ENABLED", "it is enabled")
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=LONG)
        finally:
            process.kill()
    assert process.returncode == 130, (out, err)
    assert "told to hold, and brought back" in " ".join(err.split())
    assert "Traceback" not in err
    assert engine.status.state == "DISABLED"
