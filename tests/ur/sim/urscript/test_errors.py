"""Refusals and run-time errors: the controller's text, and the script's line and column."""

from __future__ import annotations

import pytest

from crtk_sim_backends.ur.urscript import (
    Builtin,
    CompileError,
    Dialect,
    ScriptRuntimeError,
    compile_program,
)
from rigs.urscript_runtime import run, start


def refusal(text: str) -> tuple[int, int, str]:
    with pytest.raises(CompileError) as caught:
        compile_program(text, {"log": Builtin("log", print)})
    return caught.value.line, caught.value.column, caught.value.text


def test_a_function_that_is_not_simulated_is_told_apart() -> None:
    text = "def f():\n  move_mountains()\nend"
    with pytest.raises(CompileError) as caught:
        compile_program(text, {}, Dialect(frozenset({"move_mountains"})))
    assert (caught.value.line, caught.value.column, caught.value.text) == (
        2,
        3,
        "compile_error_name_not_found:move_mountains: (a function that is not simulated)",
    )


def failure(text: str, *extra: Builtin) -> tuple[int, int, str]:
    with pytest.raises(ScriptRuntimeError) as caught:
        run(text, *extra)
    return caught.value.line, caught.value.column, caught.value.text


def test_an_unknown_function_as_the_controller_reports_it() -> None:
    # What URControl answers, asserted by Universal Robots' own client library tests.
    assert refusal("def prog():\n  calldoesntexist()\nend\n") == (
        2,
        3,
        "compile_error_name_not_found:calldoesntexist:",
    )


@pytest.mark.parametrize(
    ("text", "line", "column", "name"),
    [
        ("def f():\n log(missing)\nend", 2, 6, "missing"),
        ("def f():\n log(log)\nend", 2, 6, "log"),
        ("def f():\n x = 1\n x()\nend", 3, 2, "x"),
        ("def f():\n missing[0] = 1\nend", 2, 2, "missing"),
        ("def f():\n run log()\nend", 2, 6, "log"),
        ("def f():\n thread t():\n end\n t()\nend", 4, 2, "t"),
        ("def f():\n g()\n def g():\n end\nend", 2, 2, "g"),
        ("def f():\n def g():\n  inner = 1\n end\n log(inner)\nend", 5, 6, "inner"),
        ("def f():\n log([1,\n   log(absent)])\nend", 3, 8, "absent"),
        ("def f():\n a.b()\nend", 2, 2, "a"),
        ("def f():\n a.b = 1\nend", 2, 2, "a"),
        # The variables of a function around it are out of a function's reach.
        ("def f():\n def g():\n  local a = 1\n  def h():\n   log(a)\n  end\n end\nend", 5, 8, "a"),
    ],
)
def test_names_out_of_reach(text: str, line: int, column: int, name: str) -> None:
    assert refusal(text) == (line, column, f"compile_error_name_not_found:{name}:")


@pytest.mark.parametrize(
    ("text", "line", "column", "quoted"),
    [
        # Seen on a controller: an unclosed call is noticed at the next line.
        ("def prog():\n    log(1\nend\n", 3, 1, "end"),
        ("def prog():\n    log([0.5, -1, a=0.25)\nend", 2, 20, "    log([0.5, -1, a=0.25)"),
        ("def f():\n log(1)", 2, 8, " log(1)"),
        ("def f():\n x = ?\nend", 2, 6, " x = ?"),
        ('def f():\n log("open)\nend', 2, 6, ' log("open)'),
        ("def f():\n break\nend", 2, 2, " break"),
        ('log("two\nlines" ?', 2, 8, 'lines" ?'),
        ("def f():\n while True:\n  def g():\n   break\n  end\n end\nend", 4, 4, "   break"),
        ("def f(a, a):\nend", 1, 10, "def f(a, a):"),
        ("def f(a):\nend", 1, 1, "def f(a):"),
        ("def f():\n def g(a=1, b):\n end\nend", 2, 13, " def g(a=1, b):"),
        ("def f():\n 1 = 2\nend", 2, 4, " 1 = 2"),
        ("def f():\n log(1, log=2, 3)\nend", 2, 16, " log(1, log=2, 3)"),
        ("def f():\n x = 0xFFFFFFFFFFFFFFFFFF\nend", 2, 6, " x = 0xFFFFFFFFFFFFFFFFFF"),
        ("def f():\n x = 1e999\nend", 2, 6, " x = 1e999"),
        ("def f():\n a. = 1\nend", 2, 5, " a. = 1"),
        ("def f():\n a = 1.\n b = a. = 2\nend", 3, 9, " b = a. = 2"),
        ("def f():\n g()[0] = 2\nend", 2, 9, " g()[0] = 2"),
        ("def f():\n x = struct(1)\nend", 2, 6, " x = struct(1)"),
        ("def f():\n x = struct()\nend", 2, 6, " x = struct()"),
        ("def f():\n x = ! \nend", 3, 1, "end"),
        ("def f():\n for i in [1]:\n end\nend", 2, 14, " for i in [1]:"),
        ("end", 1, 1, "end"),
        ("def f():\n if True:\n else:\n elif True:\n end\nend", 4, 2, " elif True:"),
        ("def if():\nend", 1, 5, "def if():"),
        ("x = [1, 2", 1, 10, "x = [1, 2"),
        ("x = y[]", 1, 7, "x = y[]"),
    ],
)
def test_syntax_errors(text: str, line: int, column: int, quoted: str) -> None:
    assert refusal(text) == (line, column, f"syntax_error_on_line:{line}:{quoted}:")


@pytest.mark.parametrize(
    ("statement", "text"),
    [
        ("x = 1 / 0", "Division by zero"),
        ("x = 1 % 0", "Division by zero"),
        ("log(q[2])", "Index out of range"),
        ("log(q[-1])", "Index out of range"),
        ("q[2] = 1", "Index out of range"),
        ("q[-1] = 1", "Index out of range"),
        ("x = q + [1]", "Type error: lists of different lengths (2 and 1)"),
        ("x = [[1, 2]] * [1]", "Type error: matrix dimensions do not match"),
        ('x = "a" + 1', "Type error: operator + takes two strings or none"),
        ('x = 1 + "a"', "Type error: wrong type of operand or argument"),
        ("x = q.a", "Type error: no such member (a)"),
        ("i.a = 1", "Type error: only a struct has a member a"),
        ("q.a = 1", "Type error: only a struct has a member a"),
        ("s.b = 1", "Type error: the struct has no member b"),
        ("log(s.b)", "Type error: no such member (b)"),
        ("log(s[1])", "Index out of range"),
        ("s[1] = 0", "Index out of range"),
        ("x = struct(a=1) + 1", "Type error: wrong type of operand or argument"),
        ("q.append(3)", "List capacity exceeded: 2"),
        ("q.extend([3])", "List capacity exceeded: 2"),
        ("q.insert(3, 1)", "Index out of range"),
        ("q.remove(2)", "Index out of range"),
        ("q.sort()", "Type error: a value has no method sort"),
        ("q.append()", "Type error: append takes exactly 1 argument"),
        ("i.append(2)", "Type error: a value has no method append"),
        ("m.pop()", "Type error: the size of a matrix cannot be changed"),
        ("e.pop()", "Index out of range"),
        ('x = "%d" % 1', "Type error: operator % does not take strings"),
        ('x = "a" * 3', "Type error: operator * takes numbers and lists"),
        ('x = q + "a"', "Type error: wrong type of operand or argument"),
        ("x = 1 + none()", "Type error: wrong type of operand or argument"),
        ("x = (1 + 1)[0]", "Type error: wrong type of operand or argument"),
        ("log(unset)", "Variable used before it has a value (unset)"),
        ("x = 4000000000 * 4000000000", "Value out of range: integer overflow"),
        ("x = sqrt(-1)", "Value out of range"),
        ("x = pow(10, 1000)", "Value out of range"),
        ("x = endless(1)", "Too many nested function calls"),
        ("x = none(1)", "Type error: none takes ()"),
        ("x = endless()", "Type error: endless takes (n)"),
        ("x = endless(n=1, m=2)", "Type error: endless takes (n)"),
        ("x = endless(1, n=2)", "Type error: endless takes (n)"),
        ("x = str_at('abc', 3)", "Index out of range: str_at"),
        ("x = sin(1, 2)", "Type error: sin takes exactly 1 argument"),
        ("x = pow(1)", "Type error: pow takes exactly 2 arguments"),
        ("x = str_sub('a')", "Type error: str_sub takes 2 to 3 arguments"),
        ("x = sin(g=1)", "Type error: sin takes exactly 1 argument"),
        ("kill q", "Type error: wrong type of operand or argument"),
    ],
)
def test_runtime_errors(statement: str, text: str) -> None:
    script = f"""def f():
  q = [1, 2] s = struct(a=1) m = [[1], [2]] e = [] i = 5
  def none():
  end
  def endless(n):
    return endless(n + 1)
  end
  if False:
    unset = 0
  end
   {statement}
end"""
    line, column, found = failure(script)
    assert found == text
    assert (line, column) == ((6, 5) if text.startswith("Too many") else (11, 4))


def test_errors_point_into_the_innermost_function_and_thread() -> None:
    script = """def f():
  def g(a):
    return 1 / a
  end
  thread t():
    sync()
    while g(0) > 1:
    end
  end
  run t()
  while True:
    sync()
  end
end"""
    assert failure(script) == (3, 5, "Division by zero")


@pytest.mark.parametrize("blocking", [False, True])
def test_an_error_of_a_builtin_gets_its_position(blocking: bool) -> None:
    def refuse():
        if blocking:
            yield
        raise ScriptRuntimeError("no inverse kinematics")

    def refuse_at_once() -> None:
        raise ScriptRuntimeError("no inverse kinematics")

    builtin = Builtin("refuse", refuse if blocking else refuse_at_once, blocking)
    script = "def f():\n sync()\n if True:\n   refuse()\n end\nend"
    assert failure(script, builtin) == (4, 4, "no inverse kinematics")


def test_a_defect_of_a_builtin_is_reported_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> None:
        raise KeyError("a bug")

    assert failure("broken()", Builtin("broken", broken)) == (
        1,
        1,
        "Internal error of a built-in function",
    )
    assert "a bug" in caplog.text


@pytest.mark.parametrize(
    "script",
    [
        "def f():\n while True:\n end\nend",
        "def f():\n x = 1\n while True:\n  x = x + 1\n end\nend",
        "def f():\n def g(n):\n  if n > 0:\n   g(n - 1)\n   g(n - 1)\n  end\n end\n g(60)\nend",
        "def f():\n global h = 0\n thread t():\n  h = run t()\n end\n h = run t()\n sleep(1)\nend",
    ],
    ids=["empty loop", "counting loop", "doubling recursion", "threads that start threads"],
)
def test_an_infinite_loop_stops_the_program(script: str) -> None:
    line, _, text = failure(script)
    assert line > 1
    assert text.startswith("Runtime error: The program used too much time without instructing")


def test_the_same_loop_with_sync_is_legitimate() -> None:
    runtime = start("def f():\n while True:\n  sync()\n end\nend", [])
    for _ in range(1000):
        runtime.step()
    assert not runtime.finished


def test_a_heavy_computation_is_let_through() -> None:
    script = "def f(): i = 0 while i < 50000: i = i + 1 end log(i) end"
    assert run(script) == [50000]


GROWTH = {
    "s = str_cat(s, s)": "Value out of range: string longer than 1023",
    "s = s + s": "Value out of range: string longer than 1023",
    "n = n * n": "Value out of range: integer overflow",
    "n = n + n": "Value out of range: integer overflow",
    "q = [q, q]": "Type error: lists are nested too deep",
    "t = struct(a=t, b=t)": "Type error: lists are nested too deep",
    "q = [q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q, q]": (
        "Value out of range: a list of more than 20000 items"
    ),
    "q = make_list(1000, make_list(10, q)[0])": "Type error: make_list makes no list of lists",
    "t = struct(a=make_list(100, t))": "Value out of range: a list of more than 20000 items",
    "q = make_list(100000, 0)": "Value out of range: a list of 100000 items out of 100000",
    "q = make_list(100, t, 300) q.append(struct(a=make_list(19950, 0)))": (
        "Value out of range: a list of more than 20000 items"
    ),
    "c[n] = make_list(1000, 0) n = n + 1": "Value out of range: a list of more than 20000 items",
    "b[n].a = make_list(1000, 0) n = n + 1": "Value out of range: a list of more than 20000 items",
    "t.a = t": "Type error: lists are nested too deep",
    "c[0] = c": "Type error: lists are nested too deep",
    "q = transpose(make_list(5000, 1)) * [make_list(100, 1)]": (
        "Value out of range: the matrices are too large"
    ),
    "q = inv(transpose(make_list(40, 1)) * [make_list(40, 1)])": (
        "Value out of range: inv of more than 30 rows"
    ),
}


@pytest.mark.parametrize("statement", GROWTH)
def test_values_cannot_grow_without_bound_in_one_tick(statement: str) -> None:
    script = f"""def f():
  s = "x"
  n = 3
  q = [3]
  t = struct(a=1) b = make_list(100, t) c = make_list(100, 0)
  while True:
    {statement}
  end
end"""
    line, _, text = failure(script)
    assert line == 7
    assert text == GROWTH[statement]


def test_an_expensive_program_without_loops_is_stopped_as_well() -> None:
    product = "  m = m * m\n" * 3000
    script = f"def f():\n  m = transpose(make_list(30, 1)) * [make_list(30, 0.01)]\n{product}end"
    line, _, text = failure(script)
    assert text.startswith("Runtime error: The program used too much time")
    assert line < 2000


def test_slow_builtins_in_an_endless_loop_do_not_hang_the_simulator() -> None:
    slow = Builtin("slow", lambda: sum(range(20_000)))
    text = failure("def f():\n while True:\n  slow()\n end\nend", slow)[2]
    assert text.startswith("Runtime error: The program used too much time without instructing")


def test_threads_have_a_limit() -> None:
    script = (
        "def f():\n thread t():\n  while True:\n   sync()\n  end\n end\n"
        " while True:\n  run t()\n  sync()\n end\nend"
    )
    assert failure(script)[2] == "Too many threads: more than 100"
