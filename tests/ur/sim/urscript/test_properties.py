"""Properties: expressions agree with a reference, and no text harms the compiler or the runtime."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.ur.program.running import ProgramRuntime
from crtk_sim_backends.ur.urscript import (
    PURE_BUILTINS,
    Builtin,
    CompileError,
    ScriptError,
    ScriptRuntimeError,
    compile_program,
    timing_builtins,
)
from rigs.urscript_runtime import TICK, run

# A tree is (operator, operands...) or a plain value; strength is how tight an operator binds.
STRENGTH = {"or": 1, "xor": 1, "and": 2, "not": 3, "neg": 7}
STRENGTH |= dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), 4)
STRENGTH |= {"+": 5, "-": 5, "*": 6, "/": 6, "%": 6}


def product(a: float, b: float) -> float:
    if isinstance(a * b, int) and abs(a * b) >= 2**63:
        raise OverflowError
    return a * b


MEANING: dict[str, Any] = {
    "xor": operator.ne,
    "not": operator.not_,
    "neg": operator.neg,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "+": operator.add,
    "-": operator.sub,
    "*": product,
    "/": operator.truediv,
    "%": operator.mod,
}
ARITHMETIC = ("+", "-", "*", "/", "%")
COMPARISONS = ("==", "!=", "<", "<=", ">", ">=")

integers = st.integers(0, 99)
numbers = st.deferred(
    lambda: (
        integers
        | st.floats(0, 1e3).map(lambda value: round(value, 3))
        | st.tuples(st.just("neg"), numbers)
        | st.tuples(st.sampled_from(ARITHMETIC), numbers, numbers)
    )
)
truths = st.deferred(
    lambda: (
        st.booleans()
        | st.tuples(st.just("not"), truths)
        | st.tuples(st.sampled_from(COMPARISONS), numbers, numbers)
        | st.tuples(st.sampled_from(("and", "or", "xor", "==", "!=")), truths, truths)
    )
)


def written(tree: Any, blank: str) -> tuple[str, int]:
    """Write a tree with no more parentheses than the grammar needs; return text and strength."""
    if not isinstance(tree, tuple):
        return str(tree), 9
    word, *operands = tree
    strength = STRENGTH[word]
    codes = []
    for place, operand in enumerate(operands):
        code, inner = written(operand, blank)
        # Left-associative: the right operand of an equally strong operator needs parentheses.
        codes.append(code if inner >= strength + (place > 0) else f"({blank}{code})")
    if len(codes) == 2:
        return f"{codes[0]}{blank}{word}{blank}{codes[1]}", strength
    return f"{'-' if word == 'neg' else 'not'}{blank}{codes[0]}", strength


def meaning(tree: Any) -> Any:
    if not isinstance(tree, tuple):
        return tree
    word, *operands = tree
    if word in ("and", "or"):  # the right side counts only if the left one does not decide
        first = meaning(operands[0])
        return meaning(operands[1]) if first is (word == "and") else first
    return MEANING[word](*map(meaning, operands))


@given(numbers | truths, st.sampled_from([" ", "\n", " # why\n\t"]))
def test_expressions_mean_what_the_reference_says(tree: Any, blank: str) -> None:
    text = f"log({written(tree, blank)[0]})"
    try:
        expected = meaning(tree)
    except ZeroDivisionError:
        with pytest.raises(ScriptRuntimeError, match="Division by zero"):
            run(text)
    except OverflowError:
        with pytest.raises(ScriptRuntimeError, match="out of range"):
            run(text)
    else:
        (result,) = run(text)
        assert type(result) is type(expected)
        assert result == expected


WORDS = (
    "def f() : end g thread t sec if elif else while True False return break continue halt pass "
    "global local run kill join enter_critical exit_critical and or xor not x y p [ ] ( ) , = == "
    '!= < > + - * / % 0 1 2.5 0x1F "text" sync() sleep(0.01) log(x) f(x=1) t() $ # '
    "x=1 h=run\nt() p[0,0,0,0,0,0] [1,2] x[0] while\nTrue: if\nx: def\ng(a,b=1): thread\nt(): "
    ". ! .m .append(1) .pop() struct(m=1) s=struct(m=x) s.m=1 make_list(2,x,9) for switch 'it"
)
BUILTINS = {
    **PURE_BUILTINS,
    **timing_builtins(TICK),
    "log": Builtin("log", lambda value: None),
}


def error_of(action: Callable[[], object], kind: type[ScriptError]) -> ScriptError | None:
    try:
        action()
    except kind as error:
        return error
    return None


def compile_and_run(text: str) -> None:
    """Whatever the text: a compile error, a run-time error, or nothing, and all of it soon."""
    error = error_of(lambda: compile_program(text, BUILTINS), CompileError)
    if error is None:
        # A hundredth of the usual tick, for a hundredth of the loops that it allows.
        runtime = ProgramRuntime(compile_program(text, BUILTINS), TICK / 100)
        runtime.start()
        error = error_of(lambda: [runtime.step() for _ in range(20)], ScriptRuntimeError)
        assert runtime.finished or error is None
        runtime.stop()
    if error is not None:
        assert error.text
        assert 1 <= error.line <= text.count("\n") + 1
        assert error.column >= 1


@given(st.text())
def test_random_text(text: str) -> None:
    compile_and_run(text)


@given(st.binary(max_size=200))
def test_random_bytes(data: bytes) -> None:
    compile_and_run(data.decode("utf-8", "replace"))
    compile_and_run(data.decode("latin-1"))


@given(st.lists(st.sampled_from(WORDS.split(" ")), max_size=40))
def test_random_words(words: list[str]) -> None:
    compile_and_run(" ".join(words))


names = st.sampled_from(["x", "y", "z", "s.m", "s.n"])
simple = st.one_of(
    st.builds("{} = {}".format, names, names | st.just("[1, 2]") | integers.map(str)),
    st.builds("{0} = {0} {1} {2}".format, names, st.sampled_from(ARITHMETIC), names),
    st.builds("{}[{}] = {}".format, names, names | integers.map(str), names),
    st.builds("{} x = {}".format, st.sampled_from(["local", "global"]), names),
    st.builds("s = struct(m={}, n={})".format, names, names),
    st.builds("{} = make_list({}, {}, 9)".format, names, integers.map(str), names),
    st.builds("{}.{}".format, names, st.sampled_from(["append(x)", "pop()", "extend(y)", "no(x)"])),
    st.builds("x = [{0}, {0}, {1}]".format, names, names),
    st.sampled_from(
        ["sync()", "h = run t()", "kill h", "join h", "f()", "x = g(y)", "return", "halt"]
    ),
    st.sampled_from(["enter_critical", "exit_critical", "log(x)"]),
)
blocks = st.recursive(
    st.lists(simple, max_size=4).map("\n".join),
    lambda inner: st.one_of(
        st.builds("if {} == {}:\n{}\nelse:\n{}\nend".format, names, names, inner, inner),
        st.builds("while {}:\n{}\nend".format, names | st.just("True"), inner),
        st.builds("def f():\n{}\nend\n{}".format, inner, inner),
        st.builds("def g(x):\n{}\nreturn x\nend\n{}".format, inner, inner),
        st.builds("thread t():\n{}\nend\n{}".format, inner, inner),
    ),
    max_leaves=8,
)


@given(blocks)
def test_random_programs(block: str) -> None:
    compile_and_run(
        "def prog():\nx = 1\ny = [1, 2]\nh = 0\ns = struct(m=1, n=y)\n"
        "def f():\nend\ndef g(a):\nreturn a\nend\n"
        f"thread t():\nsync()\nend\n{block}\nend"
    )


@pytest.mark.sweep(7)
@pytest.mark.parametrize("depth", [10, 59, 100, 1000, 20_000])
@pytest.mark.parametrize(
    ("opening", "middle", "closing"),
    [
        ("(", "1", ")"),
        ("[", "1", "]"),
        ("- ", "1", ""),
        ("not ", "True", ""),
        ("norm(", "1", ")"),
        ("f(", "1", ")"),
        ("x[", "0", "]"),
        ("", "x", ".a"),
        ("struct(a=", "1", ")"),
        ("", "x", ".a()"),
        ("!", "True", ""),
        ("1 + ", "1", ""),
        ("(1 + ", "1", ")"),
        ("True or ", "True", ""),
        ("1 < ", "1", ""),
        ("if True:\n", "", "\nend"),
        ("while True:\n", "", "\nend"),
        ("def g():\n", "", "\nend"),
        ("if x:\nelif x:\n", "", "\nend"),
        ("elif x:\n", "", ""),
        ("[[1]", "", "]"),
    ],
)
def test_deep_nesting_is_compiled_or_refused(
    depth: int, opening: str, middle: str, closing: str
) -> None:
    nested = opening * depth + middle + closing * depth
    if opening.startswith("elif"):
        nested = f"if x:\n{nested}end"
    text = f"def f(x):\nreturn x\nend\nx = [0]\n{nested}"
    error = error_of(lambda: compile_program(text, BUILTINS), CompileError)
    if error is not None:
        assert depth > 10 or opening == "[[1]"
        assert error.text.startswith("syntax_error_on_line:")


def test_reasonable_nesting_is_compiled() -> None:
    expression = "(" * 20 + "1" + ")" * 20
    arms = "".join(f"elif x == {n}:\nx = x\n" for n in range(200))
    chain = " or ".join(["x == 1"] * 500)
    compile_program(
        f"x = {expression}\nif x == 0:\n{arms}end\ny = {chain}\nz = {' + '.join('1' * 70)}",
        BUILTINS,
    )
