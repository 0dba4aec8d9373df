"""What scripts mean: known answers for expressions, scopes, functions and control flow."""

from __future__ import annotations

import pytest

from crtk_sim_backends.ur.urscript import Builtin, List, Pose, Struct, compile_program
from rigs.urscript_runtime import run


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("10 - 4 - 3", 3),
        ("7 / 2", 3.5),
        ("7 % 4", 3),
        ("2 * -sin(0)", 0.0),
        ("'a' + \"b\" +\n 'c'", "abc"),
        ("! True", False),
        ("!(1 == 2) and ! False", True),
        ("-2 * -3", 6),
        ("- 2 + 5", 3),
        ("+4", 4),
        ("0x1F", 31),
        ("0XaB", 171),
        (".5 + 5.", 5.5),
        ("1e3", 1000.0),
        ("2.5e-1", 0.25),
        ("True and not False", True),
        ("not 1 == 2", True),
        ("True or False and False", True),
        ("True xor True", False),
        ("True xor False", True),
        ("False or True xor True", False),
        ("1 < 2 == True", True),
        ("1 <= 1 and 2 >= 3", False),
        ("1 != 2", True),
        ("'single' == \"single\"", True),
        ('"a # b"', "a # b"),
        ("[1, 2] + [10, 20]", [11, 22]),
        ("[10, 20] - [1, 2]", [9, 18]),
        ("[1, 2, 3] * [10, 20, 30]", [10, 40, 90]),
        ("[10, 20] / [4, 5]", [2.5, 4.0]),
        ("[10, 21] % 4", [2, 1]),
        ("[1, 2] * 5", [5, 10]),
        ("5 * [[1, 2], [3, 4]]", [[5, 10], [15, 20]]),
        ("10 / [5, 4]", [2.0, 2.5]),
        ("1 - [5, 4]", [-4, -3]),
        ("1 + [5, 4]", [6, 5]),
        ("9 % [5, 4]", [4, 1]),
        ("-[1, -2]", [-1, 2]),
        ("[[1, 2], [3, 4], [5, 6]] * [[10, 20], [30, 40]]", [[70, 100], [150, 220], [230, 340]]),
        ("[[1, 2], [3, 4], [5, 6]] * [10, 20]", [50, 110, 170]),
        ("[[1, 2], [3, 4]][1, 0]", 3),
        ("[[1, 2], [3, 4]][1][1]", 4),
        ("[]", []),
        ("p[1, 2, 3, 0, 0, 0]", [1, 2, 3, 0, 0, 0]),
        ("p[1, 2, 3, 0, 0, 0] * 2", [2, 4, 6, 0, 0, 0]),
    ],
)
def test_expression(expression: str, value: object) -> None:
    (result,) = run(f"log({expression})")
    assert result == value
    assert isinstance(value, list) or type(result) is type(value)


def test_a_pose_stays_a_pose_and_a_list_a_list() -> None:
    pose, moved, plain = run(
        "def f():\n a = p[1,2,3,4,5,6]\n log(a)\n log(a + a)\n log([1,2,3,4,5,6])\nend"
    )
    assert isinstance(pose, Pose)
    assert isinstance(moved, Pose)
    assert not isinstance(plain, Pose)


def test_a_variable_named_p_is_indexed() -> None:
    assert run("def f():\n p = [5, [6, 7]]\n p[0] = p[0] + 1\n log(p[0])\n log(p[1,1])\nend") == [
        6,
        7,
    ]


def test_line_ends_do_not_separate_statements() -> None:
    assert run("def f(): a = # the value\n\n  1 b = a +\n 2 log(a) log([a,\n b]) end") == [
        1,
        [1, 3],
    ]


def test_return_takes_a_value_from_its_own_line_only() -> None:
    assert run("def f():\n def g():\n  return\n  1\n end\n log(g() == 1)\n log(2)\nend") == [
        False,
        2,
    ]


def test_control_flow() -> None:
    script = """
    def f():
      i = 0
      while True:
        i = i + 1
        if i == 2:
          continue
        elif i == 5:
          break
        elif i == 4:
          log("four")
        else:
          log(i)
        end
      end
      if False:
      end
      while i < 7: i = i + 1 end
      log(i)
    end
    """
    assert run(script) == [1, 3, "four", 7]


def test_functions_take_default_and_keyword_arguments() -> None:
    script = """
    def f():
      def g(a, b=2, c=[3]):
        log([a, b, c])
        c[0] = 99
      end
      g(1)
      g(1, c=[5])
      g(b=7, a=6)
      g(1, 2, [4])
    end
    """
    assert run(script) == [[1, 2, [3]], [1, 2, [5]], [6, 7, [3]], [1, 2, [4]]]


def test_a_parameter_named_like_a_python_keyword() -> None:
    assert run(
        "def f(): def g(async, lambda=2): return async + lambda end log(g(async=1)) end"
    ) == [3]


def test_functions_call_each_other_and_themselves() -> None:
    script = """
    def f():
      def even(n):
        if n == 0: return True end
        return odd(n - 1)
      end
      def odd(n):
        if n == 0: return False end
        return even(n - 1)
      end
      log(even(10))
      log(even(7))
    end
    """
    assert run(script) == [True, False]


# Scopes (URScript manual, "Scoping rules")


def test_assignment_binds_what_was_declared_before_the_function() -> None:
    script = """
    def f():
      early = 1
      global known = 1
      def g():
        early = 2
        known = 2
        late = 2
      end
      late = 1
      g()
      log([early, known, late])
    end
    """
    assert run(script) == [[2, 2, 1]]


def test_local_and_global_say_which_variable() -> None:
    script = """
    def f():
      a = 1
      def g():
        local a = 5
        a = a + 1
        global a = 10
        global b = a
        def h():
          a = a + 100
        end
        h()
        log(a)
      end
      g()
      log([a, b])
    end
    """
    assert run(script) == [6, [110, 6]]  # the manual: in a nested function the name is global again


def test_a_declaration_without_a_value() -> None:
    script = """
    def f():
      def g():
        local x
        global y
        def h():
          x = 3
          y = 4
        end
        h()
        x = 5
        log(x)
      end
      g()
      log(y)
    end
    """
    assert run(script) == [5, 4]


def test_an_inner_assignment_is_not_captured_by_a_later_declaration_around_it() -> None:
    script = """
    def f():
      x = 1
      def g():
        def h():
          x = 2
        end
        local x = 5
        h()
        log(x)
      end
      g()
      log(x)
    end
    """
    assert run(script) == [5, 2]


def test_the_programs_own_variables_are_global_whatever_they_are_declared() -> None:
    script = """
    def f():
      local a = 0
      def g():
        a = 1
      end
      g()
      log(a)
    end
    """
    assert run(script) == [1]


def test_a_variable_may_have_the_name_of_a_function() -> None:
    assert run(
        "def f(): length = length([1, 2]) log(length) def sin(): return 1 end log(sin()) end"
    ) == [
        2,
        1,
    ]


def test_parameters_are_local() -> None:
    assert run("def f(): a = 1 def g(a): a = 2 return a end log(g(0)) log(a) end") == [2, 1]


def test_each_start_has_variables_of_its_own() -> None:
    script = "def f():\n global n = 0\n def g():\n  n = n + 1\n end\n g()\n log(n)\nend"
    assert run(script) == [1]
    assert run(script) == [1]


# Values


def test_lists_are_copied_on_assignment() -> None:
    script = """
    def f():
      a = [1, [2, 3]]
      b = a
      c = a[1]
      d = [a, a]
      a[0] = 9
      a[1, 0] = 9
      log(b)
      log(c)
      log(d)
      x = [0, 0]
      x[0] = b
      b[0] = 7
      log(x)
    end
    """
    assert run(script) == [
        [1, [2, 3]],
        [2, 3],
        [[1, [2, 3]], [1, [2, 3]]],
        [[1, [2, 3]], 0],
    ]


def test_lists_are_copied_into_and_out_of_functions() -> None:
    script = """
    def f():
      global shared = [1, 2]
      def change(q):
        q[0] = 9
        return q
      end
      def get():
        return shared
      end
      log(change(shared))
      log(shared)
      mine = get()
      mine[1] = 8
      log(shared)
    end
    """
    assert run(script) == [[9, 2], [1, 2], [1, 2]]


def test_a_script_cannot_change_a_list_that_a_builtin_keeps() -> None:
    kept = List([1, 2])
    script = "def f():\n q = give()\n q[0] = 9\n log(q)\nend"
    assert run(script, Builtin("give", lambda: kept)) == [[9, 2]]
    assert kept == [1, 2]


# Structs (URScript manual, "Lists and Structs")


def test_members_of_a_struct_are_read_and_assigned() -> None:
    script = """
    def f():
      s = struct(name="old", list=[1, 2, 3], inner=struct(x=1))
      s.name = "new"
      s.list[0] = s.list[2] + 1
      s.inner.x = 7
      s[0] = s[0] + "er"
      log(s.name)
      log(s.list)
      log(s.inner.x * 2)
      log(s == struct(name="newer", list=[4, 2, 3], inner=struct(x=7)))
      log(s == 1)
      log(length(s))
    end
    """
    assert run(script) == ["newer", [4, 2, 3], 14, True, False, 3]


def test_structs_are_copied_like_lists() -> None:
    script = """
    def f():
      a = struct(v=[1], w=0)
      b = a
      c = [a, a]
      a.v[0] = 9
      c[0].w = 5
      def change(s):
        s.w = 8
        return s
      end
      log(b.v)
      log(c[0].w)
      log(c[1].w)
      log(change(a).w)
      log(a.w)
      kept = a.v
      kept[0] = 0
      log(a.v)
    end
    """
    assert run(script) == [[1], 5, 0, 8, 0, [9]]


def test_a_struct_may_have_members_named_like_python_words() -> None:
    (value,) = run("s = struct(class=1, copy=2, self=3)\nlog(s)")
    assert isinstance(value, Struct)
    assert list(value.items()) == [("class", 1), ("copy", 2), ("self", 3)]


def test_lists_grow_and_shrink_within_their_capacity() -> None:
    script = """
    def f():
      q = make_list(1, 1, 5)
      q.append(2)
      q.extend([3, 4])
      q.insert(0, 0)
      log(q)
      log(q.pop())
      q.remove(1)
      log(q)
      log(q.slice(1))
      log(q.slice(0, 2))
      log([q.length(), q.capacity(), q.excess_capacity()])
      copy = q
      copy.append(9)
      log(q)
      log(copy.to_string())
      q.clear()
      log(q)
      fixed = [1, 2]
      fixed.pop()
      fixed.append(3)
      log(fixed)
      s = struct(l=make_list(0, 0, 3))
      s.l.append(4)
      log(s.l)
    end
    """
    assert run(script) == [
        [0, 1, 2, 3, 4],
        4,
        [0, 2, 3],
        [2, 3],
        [0, 2],
        [3, 5, 2],
        [0, 2, 3],
        "[0,2,3,9]",
        [],
        [1, 3],
        [4],
    ]


def test_a_method_cannot_change_a_list_that_a_builtin_keeps() -> None:
    kept = List([1, 2])
    assert run("log(give().pop())", Builtin("give", lambda: kept)) == [2]
    assert kept == [1, 2]


# Programs


@pytest.mark.parametrize(
    ("text", "name", "kind"),
    [
        ("def prog():\nend", "prog", "def"),
        ("\n# c\nsec quick():\n end\n", "quick", "sec"),
        ("log(1)", "", "statements"),
        ("", "", "statements"),
        ("def prog():\n log(1)\nend\nprog()", "", "statements"),
    ],
)
def test_name_and_kind(text: str, name: str, kind: str) -> None:
    program = compile_program(text, {"log": Builtin("log", print)})
    assert (program.name, program.kind) == (name, kind)


def test_loose_statements_and_calls_run() -> None:
    assert run("a = 2\nlog(a)\ndef g(): log(3) end\ng()") == [2, 3]


def test_program_labels_are_skipped() -> None:
    assert run('def f():\n $ 1 "Robot Program"\n $ 2 "Wait" "noBreak"\n log(1)\nend') == [1]
