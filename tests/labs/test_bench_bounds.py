"""The bounds of a lab file: what is judged by them, and what is refused, with its line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import Lab, load_lab
from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.bounds import check_bounds
from crtk_drivers.labs.bench.catalogue import QUANTITIES
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.labs.verdicts.estimates import exact
from crtk_drivers.labs.verdicts.judging import Bound, Comparison, Quantity, Verdict, Worse
from crtk_drivers.testing.loopback import ROTARY

SUBJECT = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)

TOLD = Quantity("force.drift", "drift", "N", Comparison.TOLD)


def lab_with(folder: Path, bound: str) -> Lab:
    path = folder / "lab.toml"
    path.write_text(f'[devices.arm]\nplugin = "loopback"\n\n[bounds."{bound}because = "so"\n')
    return load_lab(path)


@pytest.mark.parametrize(
    ("bound", "told"),
    [
        ('motion.lag.lga"]\nvalue = 1.0\n', "Did you mean 'motion.lag.lag'?"),
        ('nothing.like.it"]\nvalue = 1.0\n', "bench list --figures"),
        ('motion.lag.lag"]\nvalue = 1.0\nlower = 0.0\n', "leave `lower` out"),
        ('sampling.rate.error"]\nvalue = -1.0\nlower = 1.0\n', "lower 1 is above value -1"),
    ],
)
def test_a_bound_that_says_nothing_is_refused_with_its_line(
    tmp_path: Path, bound: str, told: str
) -> None:
    lab = lab_with(tmp_path, bound)
    with pytest.raises(ConfigError) as caught:
        check_bounds(lab, QUANTITIES)
    assert told in str(caught.value)
    assert f"{lab.path}:4: bounds." in str(caught.value)


@pytest.mark.parametrize(
    "bound",
    [
        'motion.lag.lag"]\nvalue = 1.0\n',
        'sampling.rate.error"]\nvalue = 2.0\n',
        'sampling.rate.error"]\nvalue = 2.0\nlower = -1.0\n',
        'joints.noise.sigma"]\nvalue = 0.1\n',
        'lab.press.depth"]\nvalue = 0.1\nlower = 0.0\n',
    ],
)
def test_what_says_something_is_taken(tmp_path: Path, bound: str) -> None:
    check_bounds(lab_with(tmp_path, bound), QUANTITIES)


def test_a_bound_is_a_number(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="finite"):
        lab_with(tmp_path, 'motion.lag.lag"]\nvalue = nan\n')


@pytest.mark.parametrize(
    ("worse", "entry", "verdicts"),
    [
        (Worse.HIGHER, BoundEntry(value=2.0, because="so"), (Verdict.PASS, Verdict.FAIL)),
        (Worse.LOWER, BoundEntry(value=2.0, because="so"), (Verdict.FAIL, Verdict.PASS)),
        (
            Worse.EITHER,
            BoundEntry(value=2.0, lower=0.0, because="so"),
            (Verdict.PASS, Verdict.FAIL),
        ),
        (
            Worse.EITHER,
            BoundEntry(value=4.0, lower=2.0, because="so"),
            (Verdict.FAIL, Verdict.PASS),
        ),
    ],
)
def test_what_is_only_told_is_judged_by_a_bound_of_the_lab(
    worse: Worse, entry: BoundEntry, verdicts: tuple[Verdict, Verdict]
) -> None:
    quantity = replace(TOLD, worse=worse)
    told = [SUBJECT.measured(quantity, exact(value)) for value in (1.0, 3.0)]
    assert [one.verdict for one in told] == [Verdict.PASS] * 2, "without one nothing is judged"
    subject = replace(SUBJECT, bounds={TOLD.id: entry})
    found = [subject.measured(quantity, exact(value)) for value in (1.0, 3.0)]
    assert tuple(one.verdict for one in found) == verdicts
    assert all(one.bound is not None and one.bound.source == "the lab file: so" for one in found)
    assert all(one.bound_told for one in found)


def test_one_that_is_worse_either_way_needs_both(tmp_path: Path) -> None:
    lab = lab_with(tmp_path, 'force.drift"]\nvalue = 1.0\n')
    with pytest.raises(ConfigError, match="give `lower` beside `value`"):
        check_bounds(lab, {TOLD.id: replace(TOLD, worse=Worse.EITHER)})


def test_the_lower_end_of_the_default_is_kept() -> None:
    rate = QUANTITIES["sampling.rate.error"]
    subject = replace(SUBJECT, bounds={rate.id: BoundEntry(value=2.0, because="so")})
    (low, high) = (
        subject.measured(rate, exact(value), Bound(1.0, "default", -1.0)) for value in (-1.5, 1.5)
    )
    assert (low.verdict, high.verdict) == (Verdict.FAIL, Verdict.PASS)
