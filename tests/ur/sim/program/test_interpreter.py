"""Interpreter mode in virtual time: what joins a program, what is answered, what ends it."""

import threading
from types import SimpleNamespace

import pytest

from crtk_sim_backends.ur.messages import RuntimeExceptionMessage
from crtk_sim_backends.ur.ports import interpreter_port
from crtk_sim_backends.ur.ports.interpreter_port import InterpreterSession
from crtk_sim_backends.ur.program import interpreter
from crtk_sim_backends.ur.program.compilation import LONG_SCRIPT
from crtk_sim_backends.ur.program.interpreter import CLEANED_UP, NOT_RUNNING, TOO_MANY
from crtk_sim_backends.ur.urscript import Statements
from rigs.ur_interpreter import WAIT, Interpreted

HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]


@pytest.fixture
def bench():
    return Interpreted()


@pytest.fixture
def waiting():
    return Interpreted.with_program()


# What joins the program


def test_statements_use_and_change_the_variables_of_the_program_and_call_its_functions(bench):
    bench.start("""
    a = 1
    values = [1, 2, 3]
    def twice(x):
      return 2 * x
    end
    def slowly_twice(x):
      sleep(0.01)
      return 2 * x
    end
    interpreter_mode()
    textmsg(a, values)
    """)
    bench.ticks(1)
    bench.send("a = twice(10) + slowly_twice(a)", "values[1] = a", "end_interpreter()")
    bench.until(lambda: bench.stopped)
    assert bench.texts == ["22[1,22,3]"]


def test_the_scope_is_that_of_the_call_with_its_local_variables(bench):
    bench.start("""
    global shared = 1
    hidden = 1
    def inner(given):
      local own = 10
      def helper(x):
        return x + 1
      end
      interpreter_mode()
      textmsg(own, given)
    end
    inner(5)
    textmsg(shared)
    """)
    bench.ticks(1)
    bench.send("own = helper(own)", "given = own * 2", "shared = given", "end_interpreter()")
    bench.until(lambda: bench.stopped)
    assert bench.texts == ["1122", "22"]


def test_functions_reach_a_global_variable_that_a_local_one_hides(bench):
    bench.start("""
    global x = 1
    def inner():
      local x = 10
      interpreter_mode()
      textmsg(x)
    end
    inner()
    textmsg(x)
    """)
    bench.ticks(1)
    bench.send("def f(): x = x + 1 end", "f() x = 20", "end_interpreter()")
    bench.until(lambda: bench.stopped)
    assert bench.errors == []
    assert bench.texts == ["20", "2"]


def test_each_execution_of_a_program_has_variables_of_its_own(bench):
    for _ in range(2):
        bench.start("a = 1\ninterpreter_mode()\ntextmsg(a)", name="again")
        bench.ticks(1)
        assert bench.send("a = a + 1 b = 1", "end_interpreter()")[0].startswith("ack: 1: ")
        bench.until(lambda: bench.stopped)
    assert bench.texts == ["2", "2"]


def test_what_statements_make_is_kept_for_later_ones(waiting):
    waiting.send("b = [1, 2]", "b[0] = 7", "def f(x): sync() return x + a end")
    waiting.send("c = f(b[0])")
    waiting.send("textmsg(c)")
    waiting.ticks(10)
    assert waiting.texts == ["8"]


def test_functions_do_not_reach_the_variables_of_statements(waiting):
    waiting.send("b = 1")
    assert waiting.ask("def f(): return b end").startswith("discard: Compile error: ")


def test_a_function_can_be_defined_again_as_one_that_waits(waiting):
    waiting.send("def f(): return 1 end", "def g(): return f() end")
    waiting.send("def f(): sync() return 2 end")
    waiting.ticks(3)
    waiting.send("textmsg(f(), g())")
    waiting.ticks(10)
    assert waiting.errors == []
    assert waiting.texts == ["21"]


def test_a_function_that_the_program_has_not_reached_is_not_found(bench):
    bench.start("interpreter_mode()\ndef late():\n  return 1\nend\ninterpreter_mode()")
    bench.ticks(1)
    assert bench.ask("x = late()") == "discard: Compile error: x = late()"
    bench.send("end_interpreter()")
    bench.ticks(3)
    assert bench.ask("x = late()").startswith("ack: ")


def test_a_declared_variable_without_a_value_is_a_runtime_error(bench):
    bench.start("if False:\n  a = 1\nend\ninterpreter_mode()")
    bench.ticks(1)
    bench.send("textmsg(a)")
    bench.ticks(2)
    assert bench.errors == ["Variable used before it has a value (a)"]


# Answers and numbers


def test_without_a_program_lines_are_discarded_and_the_state_is_zero(bench):
    assert bench.send("a = 1") == [f"discard: {NOT_RUNNING}: a = 1"]
    assert bench.state("statelastexecuted") == 0
    assert bench.state("stateunexecuted") == 0
    assert bench.send("abort", "skipbuffer") == ["ack: 0: abort", "ack: 0: skipbuffer"]


def test_answers_have_consecutive_numbers_from_one_and_the_line(waiting):
    assert waiting.send("b = 1", "  b = 2 c = 3\r", "", "# nothing") == [
        "ack: 1: b = 1",
        "ack: 2: b = 2 c = 3",
        "ack: 3: ",
        "ack: 4: # nothing",
    ]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("b = = 1", "Syntax error"),
        ("def f():", "Syntax error"),
        ("b = unknown", "Compile error"),
        ("unknown(1)", "Compile error"),
        ("b = 1 unknown(b)", "Compile error"),
        ("global new = 1", "Compile error"),
        ("def f(): global new = 1 end", "Compile error"),
        ("interpreter_mode()", "Compile error"),
        ("def f(): interpreter_mode() end", "Compile error"),
        ("x = 1" + 25 * " while True:" + 25 * " end", "Syntax error"),
    ],
)
def test_what_cannot_be_compiled_is_discarded_as_a_whole_and_takes_no_number(waiting, line, reason):
    assert waiting.ask(line) == f"discard: {reason}: {line}"
    assert waiting.ask("textmsg(b)") == "discard: Compile error: textmsg(b)"
    assert waiting.ask("f()") == "discard: Compile error: f()"
    assert waiting.ask("ok = 1") == "ack: 1: ok = 1"
    waiting.ticks(5)
    assert waiting.errors == []


def test_a_global_variable_of_the_program_can_be_assigned_by_functions_too(bench):
    bench.start("global g = 1\ninterpreter_mode()\ntextmsg(g)")
    bench.ticks(1)
    bench.send("global g = 2", "def f(): g = g + 1 end", "f() end_interpreter()")
    bench.until(lambda: bench.stopped)
    assert bench.texts == ["3"]


def test_states_tell_what_is_interpreted_executed_waiting_and_cleared(waiting):
    waiting.send("sleep(1)", "b = 1", "b = 2", "b = 3")
    waiting.ticks(1)
    assert waiting.state("statelastinterpreted") == 4
    assert waiting.state("statelastexecuted") == 1
    assert waiting.state("stateunexecuted") == 3
    assert waiting.state("statelastcleared") == 0
    waiting.seconds(1.1)
    assert waiting.state("statelastexecuted") == 4
    assert waiting.state("stateunexecuted") == 0
    waiting.send("clear_interpreter()")
    waiting.ticks(1)
    assert waiting.state("statelastcleared") == 5


def test_numbers_begin_anew_with_each_program(waiting):
    waiting.send("b = 1", "end_interpreter()")
    waiting.until(lambda: waiting.stopped)
    assert waiting.state("statelastinterpreted") == 0
    waiting.start("interpreter_mode()")
    waiting.ticks(1)
    assert waiting.ask("b = 1") == "ack: 1: b = 1"


def test_a_line_may_come_in_pieces_and_two_clients_get_their_own_answers(waiting):
    other = InterpreterSession(waiting.controller.interpreter)
    assert waiting.session.receive(b"b =") == b""
    assert other.receive(b"c = 2\n") == b"ack: 1: c = 2\n"
    assert waiting.session.receive(b" 1\n") == b"ack: 2: b = 1\n"


def test_more_lines_than_fit_into_a_period_are_answered_and_executed_later(waiting):
    count = 30
    waiting.send("b = 0")
    answers = waiting.send(*["b = b + 1"] * count)
    assert len(answers) < count
    for _ in range(count):
        waiting.ticks(1)
        answers += waiting.answers()
    assert len(answers) == count
    assert answers[-1] == f"ack: {count + 1}: b = b + 1"
    waiting.send("textmsg(b)")
    waiting.ticks(5)
    assert waiting.texts == [str(count)]


def test_a_long_line_is_compiled_beside_the_loop_and_keeps_its_place(waiting):
    line = "b = 0 " + "b = b + 1 " * 1000
    assert waiting.send(line) == []
    assert waiting.send("textmsg(b)") == []
    answers = []
    while len(answers) < 2:  # which a test without a limit of time must not wait for in vain
        waiting.ticks(1)
        answers += waiting.answers()
    assert answers == [f"ack: 1: {line.strip()}", "ack: 2: textmsg(b)"]
    waiting.ticks(3)
    assert waiting.texts == ["1000"]


@pytest.mark.parametrize("count", [1, 100])
def test_a_long_line_that_is_skipped_meanwhile_never_runs(waiting, count):
    line = "textmsg(1) " * 1000
    assert waiting.send(line) == []
    discarded, done = waiting.send("skipbuffer")
    assert discarded.startswith(f"discard: {CLEANED_UP}: textmsg(1)")
    assert done == "ack: 0: skipbuffer"
    assert waiting.ask("textmsg(2) " * count).startswith("ack: 1: ")
    waiting.ticks(5)
    assert waiting.texts == ["2"] * count


@pytest.fixture
def gate(monkeypatch):
    """Holds up what long lines were `compiled` to until it is `open`."""
    gate = SimpleNamespace(compiled=threading.Event(), open=threading.Event())
    at_once = Statements.compile

    def compile_slowly(statements, text):
        try:
            return at_once(statements, text)
        finally:
            if len(text) > LONG_SCRIPT:
                gate.compiled.set()
                gate.open.wait(20)

    monkeypatch.setattr(Statements, "compile", compile_slowly)
    yield gate
    gate.open.set()


def test_nothing_is_compiled_beside_a_long_line_though_it_was_skipped(waiting, gate):
    assert waiting.send("b = 0 " * 1000) == []
    assert len(waiting.send("skipbuffer")) == 2
    assert waiting.send("b = 1") == []
    waiting.ticks(5)
    assert waiting.answers() == []
    gate.open.set()
    answers = []
    while not answers:
        waiting.ticks(1)
        answers = waiting.answers()
    assert answers == ["ack: 1: b = 1"]


def test_a_long_line_is_compiled_again_when_it_has_come_into_another_scope(bench, gate):
    bench.start("""
    def inner():
      local own = 5
      interpreter_mode(clearQueueOnEnter=False)
    end
    thread ends():
      sleep(0.1)
      end_interpreter()
    end
    run ends()
    interpreter_mode()
    inner()
    """)
    bench.ticks(1)
    line = "textmsg(own) " * 100
    assert bench.send(line) == []
    assert gate.compiled.wait(20)
    bench.seconds(0.2)
    gate.open.set()
    answers = []
    while not answers:
        bench.ticks(1)
        answers = bench.answers()
    assert answers == [f"ack: 1: {line.strip()}"]


# Limits


def test_long_statements_that_have_piled_up_are_no_infinite_loop_together(waiting):
    waiting.send("sleep(1)")
    waiting.send(*["i = 0 while i < 500: i = i + 1 end"] * 300)
    while waiting.controller.time < 0.5:
        waiting.ticks(1)
        waiting.answers()
    assert waiting.state("stateunexecuted") == 300
    waiting.send("end_interpreter()")
    waiting.until(lambda: waiting.stopped)
    assert waiting.errors == []


def test_too_many_lines_are_discarded_until_the_interpreter_is_cleared(waiting, monkeypatch):
    monkeypatch.setattr(interpreter, "STATEMENT_LIMIT", 2)
    assert [waiting.ask("b = 1") for _ in range(3)] == [
        "ack: 1: b = 1",
        "ack: 2: b = 1",
        f"discard: {TOO_MANY}: b = 1",
    ]
    assert waiting.ask("clear_interpreter()") == "ack: 3: clear_interpreter()"
    assert waiting.ask("b = 1") == "ack: 4: b = 1"


@pytest.mark.parametrize(("limit", "value"), [("STATEMENT_LIMIT", 2), ("SIZE_LIMIT", 8)])
def test_too_many_lines_cannot_wait(bench, monkeypatch, limit, value):
    monkeypatch.setattr(interpreter, limit, value)
    bench.start("while True:\n  sync()\nend")
    assert bench.send("b = 1", "b = 2", "b = 3") == [f"discard: {TOO_MANY}: b = 3"]


@pytest.mark.parametrize("pieces", [1, 7, 1000])
def test_a_line_that_is_too_long_is_discarded_once_and_the_next_is_taken(waiting, pieces):
    data = b"x" * (3 * interpreter_port.LINE_LIMIT) + b"\nb = 1\n"
    size = len(data) // pieces + 1
    answers = []
    for start in range(0, len(data), size):
        answers += waiting.answers(data[start : start + size])
    assert answers == [f"discard: Line too long: {'x' * 100}", "ack: 1: b = 1"]


def test_many_statements_are_no_infinite_loop(bench):
    bench.start(f"while get_flag(1) == False:\n  sync()\nend\nb = 0\n{WAIT}\ntextmsg(b)")
    bench.send(*["b = b + 1"] * 1000, "end_interpreter()")
    bench.controller.run_script("sec go():\n  set_flag(1, True)\nend")
    bench.until(lambda: bench.stopped)
    assert bench.errors == []
    assert bench.texts == ["1000"]


# What ends the program


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("b = [1] b[5] = 2", "Index out of range"),
        ("b = 1 / 0", "Division by zero"),
        ("while True: b = 1 end", "Runtime error: The program used too much time"),
        ("def f(): return f() end f()", "Too many nested function calls"),
        ("movej([1, 2])", "movej"),
    ],
)
def test_a_runtime_error_ends_the_program(waiting, line, error):
    assert waiting.ask(line).startswith("ack: ")
    waiting.ticks(3)
    assert waiting.stopped
    assert waiting.errors[0].startswith(error)
    assert waiting.send("b = 1") == [f"discard: {NOT_RUNNING}: b = 1"]


def test_halt_and_a_protective_stop_end_it_too(bench):
    for end in ("halt", "protective_stop() sleep(1)"):
        bench.start("interpreter_mode()")
        bench.ticks(1)
        bench.send(end)
        bench.until(lambda: bench.stopped)
        assert bench.send("b = 1") == [f"discard: {NOT_RUNNING}: b = 1"]


def test_nothing_is_executed_after_the_statement_that_ends_the_program(waiting):
    for end in ("protective_stop()", "protective_stop() end_interpreter()"):
        waiting.start(WAIT)
        waiting.ticks(5)
        assert len(waiting.send("sleep(0.1)", end, "textmsg(1)")) >= 2
        waiting.until(lambda: waiting.stopped)
        waiting.ticks(5)
        assert waiting.texts == []
        assert waiting.errors == []
        waiting.controller.unlock_protective_stop(at_once=True)


def test_a_runtime_error_has_the_place_where_the_program_waits_or_that_in_its_function(bench):
    for line, place in (("b = 1 / 0", (5, 1)), ("f()", (3, 3))):
        bench.start("def f():\n  x = 1 / 0\nend\ninterpreter_mode()")
        bench.ticks(1)
        bench.send(line)
        bench.until(lambda: bench.stopped)
        error = bench.of_type(RuntimeExceptionMessage)[-1]
        assert (error.line, error.column) == place


def test_two_threads_that_move_are_an_error(waiting):
    waiting.send("thread move(): speedj([0.1, 0, 0, 0, 0, 0], 1, 1) end", "run move()")
    waiting.send(f"movej({HOME}, v=0.1) movej([0, 0, 0, 0, 0, 0])")
    waiting.ticks(5)
    assert waiting.errors == ["Another thread is already controlling the robot"]


def test_a_paused_program_takes_lines_and_executes_them_later(waiting):
    waiting.controller.pause()
    waiting.seconds(1)
    assert waiting.ask("textmsg(1)") == "ack: 1: textmsg(1)"
    waiting.ticks(5)
    assert waiting.texts == []
    waiting.controller.play()
    waiting.seconds(1)
    assert waiting.texts == ["1"]


# skipbuffer


def test_skipbuffer_skips_all_but_the_running_statement(waiting):
    waiting.send('sleep(0.1) textmsg("slept")', "textmsg(1)", "end_interpreter()", "textmsg(2)")
    waiting.ticks(1)
    assert waiting.state("stateunexecuted") == 3
    assert waiting.send("skipbuffer") == [
        f"discard: {CLEANED_UP}: textmsg(2)",
        "ack: 0: skipbuffer",
    ]
    assert waiting.state("stateunexecuted") == 0
    assert waiting.ask("textmsg(3)") == "ack: 4: textmsg(3)"
    waiting.seconds(0.2)
    assert waiting.texts == ["slept", "3"]
