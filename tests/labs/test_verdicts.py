"""Verdicts: intervals against bounds, and how they are told."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.labs.tapes.svg_canvas import svg_of_plot
from crtk_drivers.labs.verdicts.estimates import (
    Estimate,
    exact,
    greatest,
    line,
    mean,
    quantile,
    share,
    student_t,
)
from crtk_drivers.labs.verdicts.html_page import Cell, page, table
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Plot,
    Quantity,
    Series,
    Verdict,
    verdict_of,
)
from crtk_drivers.labs.verdicts.junit import Case, Suite, junit_xml

FINITE = st.floats(-1e9, 1e9)


def measured(comparison: Comparison, lower: float, upper: float, bound: Bound) -> Measurement:
    quantity = Quantity("stop.silence.time", "stop time", "s", comparison)
    return Measurement(quantity, Estimate((lower + upper) / 2, lower, upper, 10), bound)


@pytest.mark.parametrize(
    ("comparison", "lower", "upper", "verdict"),
    [
        (Comparison.AT_MOST, 0.1, 0.2, Verdict.PASS),
        (Comparison.AT_MOST, 0.1, 0.3, Verdict.INCONCLUSIVE),
        (Comparison.AT_MOST, 0.3, 0.4, Verdict.FAIL),
        (Comparison.AT_LEAST, 0.3, 0.4, Verdict.PASS),
        (Comparison.AT_LEAST, 0.1, 0.4, Verdict.INCONCLUSIVE),
        (Comparison.AT_LEAST, 0.0, 0.1, Verdict.FAIL),
        (Comparison.WITHIN, 0.0, 0.2, Verdict.PASS),
        (Comparison.WITHIN, -1.0, 0.2, Verdict.INCONCLUSIVE),
        (Comparison.WITHIN, -9.0, -8.0, Verdict.FAIL),
        (Comparison.TOLD, 5.0, 6.0, Verdict.PASS),
    ],
)
def test_the_whole_interval_decides(
    comparison: Comparison, lower: float, upper: float, verdict: Verdict
) -> None:
    bound = Bound(0.25, "default", lower=-0.25)
    assert measured(comparison, lower, upper, bound).verdict is verdict


def test_a_value_on_its_bound_passes_and_is_marginal() -> None:
    found = measured(Comparison.AT_MOST, 0.24, 0.25, Bound(0.25, "default"))
    assert found.verdict is Verdict.PASS
    assert found.is_marginal
    assert not measured(Comparison.AT_MOST, 0.0, 0.1, Bound(0.25, "default")).is_marginal
    assert not measured(Comparison.AT_MOST, 0.0, 0.0, Bound(0.0, "default")).is_marginal


def test_what_is_told_names_value_interval_bound_and_unit() -> None:
    found = measured(Comparison.AT_MOST, 0.3, 0.32, Bound(0.2, "default"))
    assert found.told == "stop time 0.31 s (0.3 to 0.32), at most 0.2 s"
    none = Measurement(found.quantity, None, Bound(0.2, "default"), why="it did not move")
    assert none.verdict is Verdict.INCONCLUSIVE
    assert none.told == "stop time: not measured: it did not move"


def test_a_violation_fails_and_a_doubt_leaves_open_whatever_was_measured() -> None:
    good = measured(Comparison.AT_MOST, 0.0, 0.1, Bound(0.25, "default"))
    bad = measured(Comparison.AT_MOST, 0.3, 0.4, Bound(0.25, "default"))
    assert Findings((good,)).verdict is Verdict.PASS
    assert Findings((good, bad)).verdict is Verdict.FAIL
    assert Findings((good, bad), doubts=("the machine is too slow",)).verdict is (
        Verdict.INCONCLUSIVE
    )
    moved = Findings((good,), ("it moved while DISABLED",), ("the machine is too slow",))
    assert moved.verdict is Verdict.FAIL
    assert moved.reason == "it moved while DISABLED"
    assert Findings().verdict is Verdict.INCONCLUSIVE


def test_nothing_judged_is_no_success() -> None:
    assert verdict_of([]) is Verdict.SKIPPED
    assert verdict_of([Verdict.SKIPPED, Verdict.PASS]) is Verdict.PASS
    assert verdict_of([Verdict.PASS, Verdict.INCONCLUSIVE]) is Verdict.INCONCLUSIVE


def test_students_t_has_the_values_of_the_tables() -> None:
    for freedom, value in ((1, 12.706), (9, 2.262), (30, 2.042), (60, 2.000), (120, 1.980)):
        assert student_t(freedom) == pytest.approx(value, abs=2e-3)
    assert student_t(0) == math.inf


def test_a_mean_has_the_interval_of_its_trials() -> None:
    found = mean([1.0, 2.0, 3.0])
    assert (found.value, found.n) == (2.0, 3)
    assert found.upper - found.value == pytest.approx(4.303 / math.sqrt(3.0))
    assert mean([5.0]).upper == math.inf


def test_a_line_has_the_interval_of_its_residuals() -> None:
    begin, slope = line([0.0, 1.0, 2.0, 3.0], [1.1, 2.9, 5.1, 6.9])
    assert (begin.value, slope.value) == pytest.approx((1.06, 1.96))
    # Residuals 0.04, -0.12, 0.12, -0.04: s = 0.1265, over the root of 5 of the places, times t of 2.
    assert slope.upper - slope.value == pytest.approx(4.303 * 0.1265 / math.sqrt(5.0), rel=1e-3)
    assert begin.upper - begin.value == pytest.approx(4.303 * 0.1265 * math.sqrt(0.7), rel=1e-3)
    for wrong in (([1.0, 1.0], [1.0, 2.0]), ([1.0, 2.0], [1.0, 2.0, 3.0])):
        with pytest.raises(ValueError, match="no line"):
            line(*wrong)


def test_wilsons_interval_has_known_values() -> None:
    found = share(0, 10)  # Wilson 1927: 0 to 0.2775
    assert (found.lower, found.value) == (0.0, 0.0)
    assert found.upper == pytest.approx(0.2775, abs=1e-4)
    half = share(5, 10)
    assert (half.lower, half.upper) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_the_interval_of_a_quantile_holds_the_true_one_nineteen_times_in_twenty() -> None:
    random = np.random.default_rng(1)
    hits = sum(
        found.lower <= 0.9 <= found.upper
        for found in (quantile(random.uniform(size=400), 0.9) for _ in range(400))
    )
    assert 0.93 <= hits / 400 <= 1.0


@given(st.lists(FINITE, min_size=1, max_size=50), st.floats(0.01, 0.99))
def test_every_estimate_lies_within_its_interval(values: list[float], at: float) -> None:
    for found in (mean(values), quantile(values, at), greatest(values)):
        assert found.lower <= found.value <= found.upper
        assert found.n == len(values)


@pytest.mark.parametrize("values", [[], [math.nan], [math.inf]])
def test_what_is_no_observation_is_refused(values: list[float]) -> None:
    for estimate in (mean, greatest, lambda found: quantile(found, 0.5)):
        with pytest.raises(ValueError, match="observation"):
            estimate(values)
    with pytest.raises(ValueError, match="not within"):
        exact(math.nan)


def test_junit_is_read_by_a_strict_parser_and_has_the_reasons() -> None:
    cases = (
        Case(
            "M2 arrives", "arm.motion", 1.5, Verdict.FAIL, "error 0.1 rad, at most 0.01", "a\x00b"
        ),
        Case("T1 rate", "arm.sampling", 10.0, Verdict.PASS),
        Case("K1 view", "arm.tracker", 0.0, Verdict.SKIPPED, "needs a tracker"),
        Case("T2 jitter", "arm.sampling", 0.0, Verdict.INCONCLUSIVE, "<the machine & its load>"),
    )
    document = junit_xml([Suite("arm", cases, {"firmware": "5.1 \ud800"}, "2026-11-24T00:00:00")])
    suite = ElementTree.fromstring(document.encode())[0]
    counts = {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")}
    assert counts == {"tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    failure = suite.find("testcase/failure")
    assert failure is not None
    assert failure.get("message") == "error 0.1 rad, at most 0.01"
    error = suite.find("testcase/error")
    assert error is not None
    assert (error.get("type"), error.get("message")) == ("inconclusive", "<the machine & its load>")
    assert not suite.findall("testcase/properties"), "strict parsers break on these"


@given(st.text())
def test_junit_takes_any_text(text: str) -> None:
    case = Case(text, text, 0.0, Verdict.FAIL, text, text)
    ElementTree.fromstring(junit_xml([Suite(text, (case,), {text: text})]).encode())


@given(st.lists(st.tuples(FINITE, st.floats()), max_size=40))
def test_any_plot_is_sound_svg(points: list[tuple[float, float]]) -> None:
    xs, ys = tuple(x for x, _ in points), tuple(y for _, y in points)
    drawn = svg_of_plot(
        Plot("a < b", "time, s", "rad", (Series("q & r", xs, ys), Series("", (), ())))
    )
    assert "nan" not in drawn
    assert "inf" not in drawn
    ElementTree.fromstring(drawn)


def test_a_long_line_keeps_its_extremes_and_becomes_short() -> None:
    x = np.linspace(0.0, 10.0, 100_000)
    y = np.zeros_like(x)
    y[54_321] = 7.0
    drawn = svg_of_plot(Plot("spike", "", "", (Series("", tuple(x), tuple(y)),)))
    assert len(drawn) < 40_000
    assert ",41.3 " in drawn, "the spike reaches the upper edge"


def test_a_page_loads_nothing_and_escapes_what_it_is_given() -> None:
    found = page("<lab>", table(("a", "b"), [("<script>", Cell("<b>1</b>"))], right=(1,)))
    assert "<script" not in found
    assert "&lt;script&gt;" in found
    assert '<td class="r"><b>1</b></td>' in found
    assert "http" not in found.replace("http-equiv", "")
