"""Figures against those of earlier runs: of the same device, simulated or real; and runs that are named."""

from __future__ import annotations

import json
import multiprocessing
import os
from itertools import pairwise
from pathlib import Path

import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import Lab, load_lab
from crtk_drivers.labs.bench import history, report
from crtk_drivers.labs.bench.folder import finish, make_folder
from crtk_drivers.labs.bench.results import DeviceResult, Measured, Result, Run, read_run
from crtk_drivers.labs.verdicts.judging import Verdict

LAG = "motion.lag.lag"


def measured(value: float, guard: float = 1.0) -> Measured:
    return Measured(
        id=LAG,
        title="lag",
        part="joint_1",
        unit="ms",
        value=value,
        lower=value,
        upper=value,
        n=1,
        comparison="at most",
        bound=100.0,
        bound_lower=None,
        bound_from="default",
        worse="higher",
        guard=guard,
        verdict=Verdict.PASS,
        marginal=False,
        told="",
        why="",
    )


def a_run(
    *values: tuple[str, bool, float],
    lab: str = "lab",
    complete: bool = True,
    verdict: Verdict = Verdict.PASS,
) -> Run:
    """Return a run: device, whether it is simulated, and its lag."""
    devices = tuple(
        DeviceResult(
            name=name,
            plugin="ur",
            address="",
            simulated=simulated,
            tests=(
                Result(
                    id="M5",
                    name="lag",
                    group="motion",
                    acquisition="sines",
                    verdict=verdict,
                    measurements=(measured(value),),
                ),
            ),
        )
        for name, simulated, value in values
    )
    return Run(
        lab=lab,
        lab_file="lab.toml",
        lab_file_sha256="",
        suite="quick",
        started="2026-11-24T00:00:00+00:00",
        complete=complete,
        devices=devices,
    )


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    return tmp_path / "runs"


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    """Of one arm that is real."""
    return lab_of(tmp_path, sim=False)


def lab_of(folder: Path, *, sim: bool) -> Lab:
    path = folder / "lab.toml"
    path.write_text('[devices.arm]\nplugin = "ur"\nsettings = { host = "192.168.1.9" }\n')
    return load_lab(path, sim=sim)


def keep(run: Run, runs: Path, name: str, **options: object) -> Run:
    make_folder(runs / name)
    kept, trouble = finish(run, runs / name, **options)  # type: ignore[arg-type]
    assert not trouble
    return kept


def values(lab: Lab, runs: Path, against: str = "all") -> list[float]:
    return [one.value for one in history.earlier_of(lab, runs, against)]


def test_worse_than_it_was_is_told_once_there_are_enough_runs(runs: Path, lab: Lab) -> None:
    for index in range(5):
        kept = keep(
            a_run(("arm", False, 20.0 + 0.01 * index)),
            runs,
            f"run{index}",
            earlier=history.earlier_of(lab, runs, "all"),
        )
        assert not kept.devices[0].tests[0].measurements[0].regressed
    earlier = history.earlier_of(lab, runs, "all")
    worse = keep(a_run(("arm", False, 25.0)), runs, "worse", earlier=earlier)
    assert worse.devices[0].tests[0].measurements[0].regressed == ("25 ms, usually 20 ± 1 (5 runs)")
    assert report.exit_code(worse) == 0
    assert report.exit_code(worse, regression_fails=True) == 1
    assert "REGRESSED" in (runs / "worse" / "report.html").read_text()
    better = keep(a_run(("arm", False, 15.0)), runs, "better", earlier=earlier)
    assert not better.devices[0].tests[0].measurements[0].regressed


def test_simulated_runs_and_real_ones_are_not_compared(
    runs: Path, lab: Lab, tmp_path: Path
) -> None:
    keep(a_run(("arm", True, 5.0)), runs, "a")
    keep(a_run(("arm", False, 20.0)), runs, "b")
    keep(a_run(("arm", True, 6.0)), runs, "c")
    assert values(lab, runs) == [20.0]
    assert values(lab, runs, "previous") == [20.0], "the newest that was real"
    simulated = lab_of(tmp_path, sim=True)
    assert values(simulated, runs) == [5.0, 6.0]
    assert values(simulated, runs, "previous") == [6.0]
    keep(a_run(("arm", False, 7.0), lab="other"), runs, "d")
    assert values(lab, runs) == [20.0], "another lab is another"


def test_what_was_not_decided_is_compared_with_nothing(runs: Path, lab: Lab) -> None:
    """Of a machine that was too busy, which is no figure of the device."""
    keep(a_run(("arm", False, 20.0)), runs, "good")
    history.make_baseline(runs / "good")
    busy = a_run(("arm", False, 90.0), verdict=Verdict.INCONCLUSIVE)
    earlier = history.earlier_of(lab, runs, "baseline")
    kept = keep(busy, runs, "busy", earlier=earlier, enough=1)
    assert not kept.devices[0].tests[0].measurements[0].regressed
    assert report.exit_code(kept, inconclusive_ok=True, regression_fails=True) == 0
    assert values(lab, runs) == [20.0]
    with pytest.raises(ConfigError, match="has no figure"):
        values(lab, runs, str(runs / "busy"))


def test_lines_of_the_version_before_are_looked_up_in_their_runs(runs: Path, lab: Lab) -> None:
    for name, simulated in (("old-sim", True), ("old-real", False), ("gone", False)):
        keep(a_run(("arm", simulated, 5.0 + simulated)), runs, name)
    (runs / "gone" / "run.json").unlink()
    index = runs / history.INDEX
    lines = [json.loads(line) for line in index.read_text().splitlines()]
    for line in lines:
        del line["simulated"]
    index.write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = history.earlier_of(lab, runs, "all")
    assert [(one.run, one.value) for one in found] == [("old-real", 5.0)]


def test_a_line_that_was_cut_off_takes_none_of_the_next_run(runs: Path, lab: Lab) -> None:
    keep(a_run(("arm", False, 20.0)), runs, "a")
    with (runs / history.INDEX).open("a") as index:
        index.write('{"half a li')
    keep(a_run(("arm", False, 21.0)), runs, "b")
    assert values(lab, runs) == [20.0, 21.0]


def test_a_disk_that_is_full_leaves_the_index_as_it_was(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(a_run(("arm", False, 20.0)), runs, "a")
    before = (runs / history.INDEX).read_text()
    write = os.write

    def some(file: int, data: bytes) -> int:
        if len(data) < 100:
            raise OSError(28, "No space left on device")
        return write(file, data[: len(data) - 50])

    monkeypatch.setattr(os, "write", some)
    make_folder(runs / "b")
    _, trouble = finish(a_run(("arm", False, 21.0)), runs / "b")
    assert trouble == f"{runs / 'b'}: results cannot be written: No space left on device"
    assert (runs / history.INDEX).read_text() == before


def add_many(runs: Path, name: str) -> None:
    run = a_run(*((f"{name}{index}", False, float(index)) for index in range(300)))
    for _ in range(5):
        history.add_to_index(run, runs, name)


def test_two_benches_may_write_the_index_at_once(runs: Path) -> None:
    runs.mkdir()
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=add_many, args=(runs, name)) for name in ("a", "b")]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    lines = (runs / history.INDEX).read_text().splitlines()
    assert len(lines) == 3000
    owners = [json.loads(line)["run"] for line in lines]
    changes = sum(one != other for one, other in pairwise(owners))
    assert changes < 10, "a run's lines are together"


def test_a_run_is_made_the_baseline_of_its_devices(runs: Path, lab: Lab, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no run is the baseline of arm, real"):
        values(lab, runs, "baseline")
    keep(a_run(("arm", False, 20.0)), runs, "good")
    keep(a_run(("arm", True, 5.0)), runs, "simulated")
    for name in ("good", "simulated"):
        history.make_baseline(runs / name)
    keep(a_run(("arm", False, 30.0)), runs, "later")
    assert values(lab, runs, "baseline") == [20.0]
    assert values(lab_of(tmp_path, sim=True), runs, "baseline") == [5.0]
    history.make_baseline(runs / "later")
    assert values(lab, runs, "baseline") == [30.0]
    earlier = history.earlier_of(lab, runs, "baseline")
    worse = keep(a_run(("arm", False, 35.0)), runs, "worse", earlier=earlier, enough=1)
    assert worse.devices[0].tests[0].measurements[0].regressed == (
        "35 ms, was 30; 1 counts as no change"
    )


def test_what_did_not_come_to_its_end_is_no_baseline(runs: Path) -> None:
    keep(a_run(("arm", False, 20.0), complete=False), runs, "cut")
    with pytest.raises(ConfigError, match="did not come to its end"):
        history.make_baseline(runs / "cut")


def test_a_run_that_is_named_must_have_something_to_compare_with(runs: Path, lab: Lab) -> None:
    keep(a_run(("arm", True, 5.0)), runs, "simulated")
    keep(a_run(("arm", False, 5.0), lab="other"), runs, "other")
    keep(a_run(("arm", False, 6.0)), runs, "real")
    assert values(lab, runs, str(runs / "real")) == [6.0]
    with pytest.raises(ConfigError, match="that run has no figure of arm, real"):
        values(lab, runs, str(runs / "simulated"))
    with pytest.raises(ConfigError, match="is a run of the lab 'other', not 'lab'"):
        values(lab, runs, str(runs / "other"))
    with pytest.raises(ConfigError, match="is no run of the bench"):
        values(lab, runs, str(runs / "nothing"))


def test_a_baseline_of_a_run_that_is_gone_is_told(runs: Path, lab: Lab) -> None:
    keep(a_run(("arm", False, 20.0)), runs, "good")
    history.make_baseline(runs / "good")
    (runs / "good" / "run.json").unlink()
    with pytest.raises(ConfigError, match="is no run of the bench"):
        values(lab, runs, "baseline")
    (runs / history.BASELINE).write_text("[")
    with pytest.raises(ConfigError, match="bench baseline RUN"):
        values(lab, runs, "baseline")


def test_what_is_kept_is_what_is_read(runs: Path) -> None:
    kept = keep(a_run(("arm", False, 20.0)), runs, "a")
    assert read_run(runs / "a") == kept
