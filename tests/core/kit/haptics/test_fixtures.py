"""Fixtures: the force is the slope of the energy, dampers only take, and bad ones are refused."""

from __future__ import annotations

import contextlib
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.haptics import (
    Box,
    Fixture,
    Motion,
    Sphere,
    Spring,
    Triple,
    Wall,
    fixtures_from,
)
from crtk_drivers.kit.haptics.fixtures import MOST_FIXTURES, sum_of
from crtk_drivers.kit.haptics.triples import dot, minus, turn

LOWER, UPPER = (-0.03, -0.04, -0.05), (0.05, 0.04, 0.03)
ELASTIC: dict[str, Fixture] = {
    "spring": Spring((0.01, 0.02, 0.03), stiffness=400.0),
    "wall": Wall((0.0, 0.0, 0.01), (1.0, 2.0, 2.0), 800.0),
    "box, inside": Box(LOWER, UPPER, 700.0),
    "box, outside": Box(LOWER, UPPER, 700.0, keep="outside"),
    "sphere, inside": Sphere((0.01, 0.0, 0.0), 0.05, 600.0),
    "sphere, outside": Sphere((0.01, 0.0, 0.0), 0.05, 600.0, keep="outside"),
}
places = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
speeds = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def slope(fixture: Fixture, place: Triple, h: float = 1e-6) -> Triple:
    def along(axis: int) -> float:
        high, low = list(place), list(place)
        high[axis] += h
        low[axis] -= h
        energies = [fixture.act(Motion((p[0], p[1], p[2]))).energy for p in (high, low)]
        return (energies[0] - energies[1]) / (2.0 * h)

    return (along(0), along(1), along(2))


@pytest.mark.parametrize("name", ELASTIC)
@given(place=places)
def test_the_force_is_the_slope_of_the_energy(name: str, place: Triple) -> None:
    fixture = ELASTIC[name]
    if name == "box, outside":  # there two faces are as near: a ridge has no slope
        gaps = sorted(
            min(p - low, high - p) for p, low, high in zip(place, LOWER, UPPER, strict=True)
        )
        if gaps[1] - gaps[0] < 1e-5:
            return
    if name == "sphere, outside" and math.dist(place, (0.01, 0.0, 0.0)) < 1e-5:
        return
    pull = fixture.act(Motion(place))
    assert pull.energy >= 0.0
    assert pull.force == pytest.approx([-each for each in slope(fixture, place)], abs=2e-3)


@given(place=places, velocity=speeds)
def test_a_surface_never_pulls_and_its_damper_only_takes(place: Triple, velocity: Triple) -> None:
    for fixture in (
        Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 500.0, 20.0),
        Box(LOWER, UPPER, 500.0, 20.0),
        Box(LOWER, UPPER, 500.0, 20.0, "outside"),
        Sphere((0.0, 0.0, 0.0), 0.05, 500.0, 20.0),
        Sphere((0.0, 0.0, 0.0), 0.05, 500.0, 20.0, "outside"),
    ):
        still, moving = fixture.act(Motion(place)), fixture.act(Motion(place, velocity=velocity))
        assert dot(moving.force, still.force) >= 0.0
        assert dot(minus(moving.force, still.force), velocity) <= 1e-9
        assert moving.energy == still.energy


@given(angle=st.floats(-3.0, 3.0))
def test_a_spring_turns_back_what_is_turned(angle: float) -> None:
    turned = (0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle))
    assert turn(turned, (0.0, 0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, angle), abs=1e-9)
    spring = Spring((0.0, 0.0, 0.0), turn_stiffness=2.0, turn_damping=0.5)
    pull = spring.act(Motion((0.0, 0.0, 0.0), turned, turning=(0.0, 0.0, 1.0)))
    assert pull.torque == pytest.approx((0.0, 0.0, -2.0 * angle - 0.5), abs=1e-9)
    assert pull.energy == pytest.approx(angle * angle)


def test_all_of_a_text_act_together() -> None:
    text = json.dumps(
        {
            "floor": {"kind": "wall", "point": [0, 0, 0], "normal": [0, 0, 2], "stiffness": 100},
            "cage": {
                "kind": "box",
                "lower": [-1, -1, -0.01],
                "upper": [1, 1, 1],
                "stiffness": 50,
                "damping": 1.5,
                "keep": "inside",
            },
            "ball": {
                "kind": "sphere",
                "center": [0, 0, 0],
                "radius": 0.5,
                "stiffness": 10,
                "keep": "outside",
            },
            "there": {"kind": "spring", "point": [0, 0, -0.03], "orientation": [0, 0, 0, 1]},
        }
    )
    found = fixtures_from(text)
    assert list(found) == ["floor", "cage", "ball", "there"]
    pull = sum_of(found, Motion((0.0, 0.0, -0.03)))
    assert pull.force == pytest.approx((0.0, 0.0, 100 * 0.03 + 50 * 0.02 - 10 * 0.47))
    assert fixtures_from("{}") == {}


WALL = {"kind": "wall", "point": [0, 0, 0], "normal": [0, 0, 1], "stiffness": 100}
REFUSED: dict[str, tuple[Any, str]] = {
    "no object": ([WALL], "not an object"),
    "no kind": ({"a": {}}, "a: kind must be one of spring, wall, box, sphere, not None"),
    "another kind": ({"a": {"kind": "torus"}}, "a: kind must be"),
    "a number": ({"a": 1}, "a: no object"),
    "missing": ({"a": {"kind": "wall", "point": [0, 0, 0]}}, "a: normal, stiffness missing"),
    "unknown": ({"a": {**WALL, "color": 1}}, "a: color: it has point"),
    "too few": ({"a": {**WALL, "point": [0, 0]}}, "a: point must be 3 numbers"),
    "text": ({"a": {**WALL, "stiffness": "1"}}, "a: stiffness must be a number"),
    "a flag": ({"a": {**WALL, "stiffness": True}}, "a: stiffness must be a number"),
    "not finite": ({"a": {**WALL, "stiffness": math.inf}}, "a: stiffness must be finite"),
    "no number": ({"a": {**WALL, "point": [math.nan, 0, 0]}}, "a: point must be finite"),
    "negative": ({"a": {**WALL, "stiffness": -1}}, "a: stiffness must be from 0"),
    "too stiff": ({"a": {**WALL, "stiffness": 1e6}}, "a: stiffness must be from 0"),
    "damped too much": ({"a": {**WALL, "damping": 1e6}}, "a: damping must be from 0"),
    "far": ({"a": {**WALL, "point": [0, 0, 11]}}, "a: point must be within 10 m"),
    "no direction": ({"a": {**WALL, "normal": [0, 0, 0]}}, "a: normal must have a direction"),
    "no box": (
        {"a": {"kind": "box", "lower": [0, 0, 0], "upper": [1, 0, 1], "stiffness": 1}},
        "a: lower .* must be below",
    ),
    "no radius": (
        {"a": {"kind": "sphere", "center": [0, 0, 0], "radius": 0, "stiffness": 1}},
        "a: radius must be above 0",
    ),
    "no side": (
        {"a": {"kind": "sphere", "center": [0, 0, 0], "radius": 1, "stiffness": 1, "keep": 1}},
        "a: keep must be inside or outside",
    ),
    "no orientation": (
        {"a": {"kind": "spring", "point": [0, 0, 0], "orientation": [0, 0, 0, 0]}},
        "a: orientation must have a norm",
    ),
    "no name": ({"": WALL}, "must have a name"),
    "too many": ({str(i): WALL for i in range(MOST_FIXTURES + 1)}, "17 fixtures, 16 at most"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_fixture_is_refused_with_its_name(case: str) -> None:
    rows, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        fixtures_from(json.dumps(rows))


@given(text=st.text(max_size=60))
def test_any_text_is_fixtures_or_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        assert isinstance(fixtures_from(text), dict)


def test_long_and_deep_texts_are_refused() -> None:
    wide = json.dumps({"\u00e9" * 15_000: WALL}, ensure_ascii=False)
    for text in ("[" * 30_000, "[" * 19_000, "{", wide):
        with pytest.raises(ValueError, match=r"longer|no JSON"):
            fixtures_from(text)
