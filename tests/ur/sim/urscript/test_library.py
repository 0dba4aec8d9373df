"""The pure built-ins, against the URScript manual."""

from __future__ import annotations

import math
from typing import Any

import pytest

from crtk_sim_backends.ur.urscript import Builtin, List, Pose, ScriptRuntimeError, to_text
from rigs.urscript_runtime import TICK, run, start


def value_of(expression: str) -> Any:
    seen: list[Any] = []
    run(f"see({expression})", Builtin("see", seen.append))
    return seen[0]


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("sin(d2r(30))", 0.5),
        ("cos(f=0)", 1.0),
        ("tan(0)", 0.0),
        ("asin(1)", math.pi / 2),
        ("acos(-1)", math.pi),
        ("atan(1)", math.pi / 4),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("r2d(d2r(10))", 10.0),
        ("sqrt(9)", 3.0),
        ("pow(base=2, exponent=10)", 1024.0),
        ("norm([3, 4])", 5.0),
        ("norm(-2)", 2),
        ("point_dist(p[1,2,3,9,9,9], p[1,2,5,0,0,0])", 2.0),
        ("normalize([3, 4])", [0.6, 0.8]),
    ],
)
def test_numbers(expression: str, value: object) -> None:
    assert value_of(expression) == pytest.approx(value)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("ceil(1.1)", 2),
        ("floor(-1.1)", -2),
        ("get_list_length([1, 2, 3])", 3),
        ("length([])", 0),
        ("transpose([[1, 2], [3, 4], [5, 6]])", [[1, 3, 5], [2, 4, 6]]),
        ("inv([[2, 0], [0, 4]])", [[0.5, 0], [0, 0.25]]),
        ("inv([[0, 1], [1, 0]]) * [3, 5]", [5, 3]),
        ("inv([[1, 2], [0.5, 2]])", [[2, -2], [-0.5, 1]]),
        ("integer_to_binary_list(5)[0]", True),
        ("integer_to_binary_list(5)[1]", False),
        ("length(integer_to_binary_list(0))", 32),
        ("binary_list_to_integer([True, False, True])", 5),
        ("binary_list_to_integer(integer_to_binary_list(-7))", -7),
        ("str_cat('a', 1)", "a1"),
        ("str_cat([1, 2.5], p[0, 0, 0, 0, 0, 1])", "[1,2.5]p[0,0,0,0,0,1]"),
        ("str_len('abc')", 3),
        ("str_empty('')", True),
        ("str_at('abc', 1)", "b"),
        ("str_sub('abcdef', 2)", "cdef"),
        ("str_sub('abcdef', 2, 3)", "cde"),
        ("str_sub('abc', 1, 99)", "bc"),
        ("str_find('abcabc', 'c')", 2),
        ("str_find('abcabc', 'c', 3)", 5),
        ("str_find('abc', 'x')", -1),
        ("to_num('12')", 12),
        ("to_num('-1.5')", -1.5),
        ("to_str(True)", "True"),
        ("to_str(0.1234567)", "0.123457"),
        ("length('four')", 4),
        ("size('four')", 4),
        ("size([1, 2, 3])", 3),
        ("size([[1, 2], [3, 4], [5, 6]])", [3, 2]),
        ("make_list(2, 'a')", ["a", "a"]),
        ("make_list(length=1, initial_value=[1][0], capacity=9)", [1]),
        ("make_list(2, 0, 5).capacity()", 5),
        ("make_list(2, 0, 5).excess_capacity()", 3),
        ("[1, 2].capacity()", 2),
        ("transpose([1, 2])", [[1], [2]]),
        ("binary_list_to_integer(make_list(40, True))", -1),
        ("to_num(' +7')", 7),
        ("to_num('0xfF')", 255),
        ("to_num('.5e1')", 5.0),
        ("to_num('-INF') < 0", True),
        ("to_str(to_num('nan'))", "nan"),
        # Strings count in bytes: this is one character of two bytes.
        ("str_len('\u00e9')", 2),
        ("str_at('\u00e9', 0) + str_at('\u00e9', 1)", "\u00e9"),
        ("str_sub('a\u00e9b', 1, 2)", "\u00e9"),
        ("str_find('\u00e9b', 'b')", 2),
        ("to_str(struct(a=1, b=[2.5]))", "struct(a=1,b=[2.5])"),
    ],
)
def test_lists_and_strings(expression: str, value: object) -> None:
    assert value_of(expression) == value


@pytest.mark.parametrize(
    "expression",
    [
        "to_num('one')",
        "str_at('abc', -1)",
        "str_sub('abc', 4)",
        "str_len(5)",
        "normalize([0, 0])",
        "to_num('1_000')",
        "to_num('')",
        "to_num('99999999999')",
        "to_num(5)",
        "str_sub('abc', 1, -1)",
        "str_find('abc', 'a', -1)",
        "get_list_length('abc')",
        "get_list_length(5)",
        "make_list(-1, 0)",
        "make_list(3, 0, 2)",
        "inv([1, 2])",
        "acos(2)",
        "log(1, 0)",
        "transpose([[1], [2, 3]])",
        "normalize('a')",
        "inv([[1, 2], [2, 4]])",
        "inv([[1, 2]])",
    ],
)
def test_wrong_arguments_are_runtime_errors(expression: str) -> None:
    with pytest.raises(ScriptRuntimeError):
        value_of(expression)


def test_text_of_values() -> None:
    assert to_text(List([1, True, "a", List([2.0])])) == "[1,True,a,[2]]"
    assert to_text(Pose([0.1, 0, 0, 0, 0, 1e-9])) == "p[0.1,0,0,0,0,1e-09]"


@pytest.mark.parametrize(("seconds", "ticks"), [(0.0, 1), (TICK, 1), (0.01, 5), (0.0111, 6)])
def test_sleep_takes_its_time_in_ticks(seconds: float, ticks: int) -> None:
    log: list[Any] = []
    runtime = start(f"sleep({seconds})\nlog(1)", log)
    for _ in range(ticks):
        runtime.step()
    assert log == []
    runtime.step()
    assert log == [1]
    assert runtime.finished
