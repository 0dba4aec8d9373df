"""The table of faults (F1 to F20), by each driver that has a rig, at its simulator: a covering part of it.

Each way in which a driver meets a fault is met once, the first of them in everything that the arm can do.
`python -m bench.faults` runs the whole product, measures, and writes docs/reliability.md.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.reliability import page
from bench.reliability.procedures import BrokenPromiseError, run
from bench.reliability.rig import Rig
from bench.reliability.rigs import RIGS
from bench.reliability.table import FAULTS, NOW_AND_THEN, Cell, covering, full, thinned
from rigs.fault_rigs import SLOW, FaultRigs

CELLS = [
    cell
    for rig in RIGS.values()
    for cell in covering(rig.name, rig.ways, rig.activities, thorough=rig.thorough)
]


def _parameters() -> Iterator[object]:
    for cell in CELLS:
        finding = cell.way.finding(cell.activity)
        mark = pytest.mark.xfail(
            strict=not finding.endswith(NOW_AND_THEN),
            raises=BrokenPromiseError,
            reason=finding,
        )
        marks = [
            *((mark,) if finding else ()),
            *((pytest.mark.slow,) if cell.driver in SLOW else ()),
        ]
        yield pytest.param(cell, id=cell.name.replace("/", "-"), marks=marks)


@pytest.mark.sweep(9)
@pytest.mark.parametrize("cell", list(_parameters()))
def test_a_fault_is_met_as_promised(rigs: FaultRigs, cell: Cell) -> None:
    rig = rigs.of(cell.driver)
    try:
        run(rig, cell)
    except BaseException:
        rigs.drop()
        raise


@pytest.mark.parametrize("rig", list(RIGS.values()), ids=list(RIGS))
def test_every_fault_is_met_or_it_is_said_why_not(rig: type[Rig]) -> None:
    met = {way.fault for way in rig.ways}
    absent = {absent.fault for absent in rig.absent}
    assert met | absent == {fault.number for fault in FAULTS}
    assert not met & absent
    assert all(absent.why for absent in rig.absent)
    named = [(way.fault, way.name) for way in rig.ways]
    assert len(named) == len(set(named))
    cells = {(cell.way.fault, cell.way.name) for cell in full(rig.name, rig.ways, rig.activities)}
    assert cells == set(named), "ways without an activity"


@pytest.mark.parametrize("rig", list(RIGS.values()), ids=list(RIGS))
def test_the_part_covers_every_way_and_every_activity(rig: type[Rig]) -> None:
    cells = covering(rig.name, rig.ways, rig.activities, thorough=rig.thorough)
    kept = {(way.fault, way.name) for way in thinned(rig.ways)}
    assert {(cell.way.fault, cell.way.name) for cell in cells} == kept
    assert {fault for fault, _ in kept} == {way.fault for way in rig.ways}
    assert not rig.thorough or {cell.activity for cell in cells} == set(rig.activities)


def test_the_page_has_the_matrix_of_the_table() -> None:
    written = page.parts(page.PAGE.read_text())
    assert written[page.MATRIX] == page.matrix(), "python -m bench.faults --write"
    for rig in RIGS.values():
        rows = written[f"## {rig.name}"].splitlines()
        for way in rig.ways:
            assert any(row.startswith(f"| {way.fault} | {way.name} |") for row in rows), way.name


def test_every_driver_is_in_the_matrix_or_named_outside() -> None:
    root = Path(__file__).parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    drivers = set(project["entry-points"]["crtk_drivers.devices"])
    inside = {rig.plugin.name for rig in RIGS.values()}
    assert inside | set(page.OUTSIDE) == drivers
    assert not inside & set(page.OUTSIDE)
    assert all((root / tests).exists() for tests in page.OUTSIDE.values())
