"""Interpreter mode in virtual time: how a program enters it, leaves it and clears it."""

import pytest

from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.program.interpreter import CLEANED_UP, NOT_RUNNING
from rigs.ur_interpreter import WAIT, Interpreted

ENDED_BY_A_THREAD = """
thread ends():
  sleep(0.1)
  end_interpreter()
end
run ends()
interpreter_mode()
"""


@pytest.fixture
def bench():
    return Interpreted()


@pytest.fixture
def waiting():
    return Interpreted.with_program()


def test_lines_before_the_mode_are_cleaned_up_when_it_begins(bench):
    bench.start("sync()\ninterpreter_mode()")
    assert bench.send("textmsg(1)") == []
    bench.ticks(3)
    assert bench.answers() == [f"discard: {CLEANED_UP}: textmsg(1)"]
    assert bench.texts == []


def test_or_are_executed_first(bench):
    bench.start(f"sync()\n{WAIT}")
    assert bench.send("textmsg(1)") == []
    bench.ticks(3)
    assert bench.answers() == ["ack: 1: textmsg(1)"]
    assert bench.texts == ["1"]


def test_lines_after_the_end_of_a_mode_wait_for_the_next(bench):
    bench.start(f'{WAIT}\ntextmsg("between")\nsleep(0.1)\n{WAIT}')
    bench.ticks(1)
    assert bench.send("end_interpreter()", "textmsg(1)") == ["ack: 1: end_interpreter()"]
    bench.ticks(2)
    assert bench.answers() == []
    assert bench.texts == ["between"]
    bench.seconds(0.2)
    assert bench.answers() == ["ack: 2: textmsg(1)"]
    assert bench.texts == ["between", "1"]


def test_lines_that_wait_at_the_end_of_the_program_are_discarded(waiting):
    assert waiting.send("sleep(1)", "end_interpreter()", "b = 1") == [
        "ack: 1: sleep(1)",
        "ack: 2: end_interpreter()",
    ]
    waiting.controller.run_script("stop program")
    assert waiting.answers() == [f"discard: {NOT_RUNNING}: b = 1"]
    assert waiting.send("b = 1") == [f"discard: {NOT_RUNNING}: b = 1"]


def test_what_a_mode_made_is_cleared_at_its_end(bench):
    bench.start("interpreter_mode()\ninterpreter_mode()")
    bench.ticks(1)
    bench.send("def f(): return 1 end", "b = 1", "end_interpreter()")
    bench.ticks(3)
    assert bench.state("statelastcleared") == 3
    assert bench.ask("b = f()") == "discard: Compile error: b = f()"


def test_or_kept_until_the_end_of_the_program_also_for_another_scope(bench):
    bench.start("""
    a = 1
    def inner():
      local own = 5
      interpreter_mode()
    end
    interpreter_mode(clearOnEnd=False)
    inner()
    """)
    bench.ticks(1)
    bench.send("def f(x): return x + a end", "b = 2", "end_interpreter()")
    bench.ticks(3)
    assert bench.state("statelastcleared") == 0
    bench.send("textmsg(f(own), b)")
    bench.ticks(3)
    assert bench.texts == ["62"]


# The functions


def test_end_interpreter_comes_after_what_is_queued(waiting):
    waiting.send("sleep(0.1)", "a = 5", "end_interpreter()")
    waiting.ticks(2)
    assert not waiting.stopped
    waiting.until(lambda: waiting.stopped)
    assert waiting.texts == ["after 5"]


def test_a_thread_of_the_program_can_end_the_mode_after_the_running_statement(bench):
    bench.start(ENDED_BY_A_THREAD + 'textmsg("after")')
    bench.ticks(1)
    bench.send("sleep(0.5)", 'textmsg("slept")', "sleep(0.5)")
    bench.seconds(0.4)
    assert bench.texts == []
    bench.until(lambda: bench.stopped)
    assert bench.texts == ["after"]


def test_a_thread_can_end_an_idle_mode_and_without_one_nothing_happens(bench):
    bench.run(ENDED_BY_A_THREAD + 'end_interpreter()\ntextmsg("after")')
    assert bench.texts == ["after"]


def test_clear_forgets_variables_functions_and_threads_before_the_next_line_is_taken(bench):
    bench.start("""
    global beats = 0
    thread own():
      while True:
        sync()
      end
    end
    run own()
    interpreter_mode()
    """)
    bench.ticks(1)
    bench.send("thread beat(): while True: beats = beats + 1 sync() end end")
    bench.send("run beat()", "b = 1", "sleep(0.1)")
    bench.ticks(1)
    assert bench.send("clear_interpreter()") == ["ack: 5: clear_interpreter()"]
    assert bench.send("textmsg(b)", "statelastcleared") == ["state: 0: statelastcleared"]
    assert bench.ask("statelastcleared") == "state: 0: statelastcleared"
    bench.seconds(0.2)
    assert bench.answers() == ["discard: Compile error: textmsg(b)"]
    assert bench.state("statelastcleared") == 5
    bench.send("textmsg(beats) sync() sync() textmsg(beats)")
    bench.ticks(5)
    first, second = bench.texts
    assert first == second != "0"


def test_a_variable_that_was_cleared_has_no_value(waiting):
    waiting.send("b = 1", "clear_interpreter()")
    waiting.ticks(1)
    waiting.send("if False: b = 2 end textmsg(b)")
    waiting.ticks(2)
    assert waiting.errors == ["Variable used before it has a value (b)"]


@pytest.mark.parametrize(
    ("body", "error"),
    [
        ("clear_interpreter()", "clear_interpreter can only be called from interpreter mode"),
        (
            "thread t():\n  interpreter_mode()\nend\nrun t()\nsleep(1)",
            "interpreter_mode can only be called in the main thread",
        ),
        ("interpreter_mode(1, 2, 3)", "Type error: interpreter_mode takes 0 to 2 arguments"),
        ("interpreter_mode(clear=True)", "Type error: interpreter_mode takes 0 to 2 arguments"),
    ],
)
def test_wrong_calls_end_the_program(bench, body, error):
    bench.start(body)
    bench.ticks(3)
    assert bench.errors == [error]


def test_modes_do_not_nest_by_way_of_a_function_of_the_program(bench):
    bench.start("def again():\n  interpreter_mode()\nend\nagain()")
    bench.ticks(1)
    assert bench.ask("again()").startswith("ack: ")
    bench.ticks(2)
    assert bench.errors == ["Nested interpreter modes are not supported"]
    assert bench.stopped


def test_a_secondary_program_cannot_enter_the_mode(bench):
    bench.controller.run_script("sec s():\n  interpreter_mode()\nend")
    bench.ticks(2)
    titles = [getattr(message, "title", "") for message in bench.messages]
    assert "SECONDARY_PROGRAM_EXCEPTION_XXX" in titles


@pytest.mark.parametrize("options", [{"version": (5, 9, 4, 0)}, {"model": "ur5"}])
def test_older_software_does_not_know_the_functions(options):
    bench = Interpreted(**options)
    bench.start("interpreter_mode()")
    assert bench.errors == ["compile_error_name_not_found:interpreter_mode:"]


def test_the_port_is_there_from_5_10_on():
    assert SimConfig(version="5.10").ports["interpreter"] == 30020
    assert SimConfig(version="10.11").ports["interpreter"] == 30020
    assert "interpreter" not in SimConfig(version="5.9").ports
    assert "interpreter" not in SimConfig(model="ur5").ports
