"""The power state machine: every row of its tables, and what it does when a drive does not follow."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.statemachine import (
    HOLDING,
    OPTION_CODES,
    STATUSWORDS,
    TIMEOUTS,
    TRANSITIONS,
    UPWARDS,
    Control,
    Drive402,
    Pattern,
    State,
    Transition,
    decode,
    next_transition,
    option_text,
)

# Statuswords that drives send (voltage, remote, target reached and mode bits set as they may be).
KNOWN = {
    0x0000: State.NOT_READY,
    0x0240: State.DISABLED,
    0x1650: State.DISABLED,
    0x0231: State.READY,
    0x0233: State.SWITCHED_ON,
    0x0237: State.ENABLED,
    0x1637: State.ENABLED,
    0x0217: State.QUICK_STOP,
    0x021F: State.FAULT_REACTION,
    0x0218: State.FAULT,
    0x0238: State.FAULT,
    0x0201: None,
}

SHOWN = {
    State.NOT_READY: 0x0210,
    State.DISABLED: 0x0250,
    State.READY: 0x0231,
    State.SWITCHED_ON: 0x0233,
    State.ENABLED: 0x0237,
    State.QUICK_STOP: 0x0217,
    State.FAULT_REACTION: 0x021F,
    State.FAULT: 0x0218,
}


@pytest.mark.parametrize(("word", "state"), KNOWN.items())
def test_a_statusword_shows_its_state(word: int, state: State | None) -> None:
    assert decode(word) is state


@pytest.mark.parametrize("row", STATUSWORDS)
def test_each_row_of_the_table_decodes_whatever_the_other_bits_are(row: Pattern) -> None:
    for others in (0x0000, 0xFFFF):
        assert decode(row.value | (others & ~row.mask)) is row.state


@given(st.integers(0, 0xFFFF))
def test_a_statusword_has_at_most_one_state(word: int) -> None:
    states = [row.state for row in STATUSWORDS if word & row.mask == row.value]
    assert len(states) <= 1
    assert decode(word) is (states[0] if states else None)


# Written down from CiA 402-2 independently of the routes.
NEXT = [
    (State.NOT_READY, State.ENABLED, 1),
    (State.DISABLED, State.ENABLED, 2),
    (State.READY, State.ENABLED, 3),
    (State.SWITCHED_ON, State.ENABLED, 4),
    (State.ENABLED, State.SWITCHED_ON, 5),
    (State.SWITCHED_ON, State.READY, 6),
    (State.READY, State.DISABLED, 7),
    (State.ENABLED, State.READY, 8),
    (State.ENABLED, State.DISABLED, 9),
    (State.SWITCHED_ON, State.DISABLED, 10),
    (State.ENABLED, State.QUICK_STOP, 11),
    (State.QUICK_STOP, State.DISABLED, 12),
    (State.QUICK_STOP, State.READY, 12),
    (State.READY, State.QUICK_STOP, 7),
    (State.SWITCHED_ON, State.QUICK_STOP, 10),
]


@pytest.mark.parametrize(("state", "goal", "number"), NEXT)
def test_the_next_transition_towards_a_goal(state: State, goal: State, number: int) -> None:
    transition = next_transition(state, goal)
    assert transition is not None
    assert transition.number == number


def test_quick_stop_is_left_upwards_only_by_a_drive_that_stays_in_it() -> None:
    assert next_transition(State.QUICK_STOP, State.ENABLED).number == 12  # type: ignore[union-attr]
    there = next_transition(State.QUICK_STOP, State.ENABLED, stays_in_quick_stop=True)
    assert there is not None
    assert there.number == 16


@pytest.mark.parametrize("goal", HOLDING)
def test_no_way_leads_out_of_a_fault(goal: State) -> None:
    assert next_transition(State.FAULT, goal) is None
    assert next_transition(State.FAULT_REACTION, goal) is None


@pytest.mark.parametrize("row", [row for row in TRANSITIONS if row.command is not None])
def test_the_controlword_of_each_transition(row: Transition) -> None:
    words = {
        2: 6,
        3: 7,
        4: 0xF,
        5: 7,
        6: 6,
        7: 0,
        8: 6,
        9: 0,
        10: 0,
        11: 2,
        12: 0,
        15: 0x80,
        16: 0xF,
    }
    assert row.command == words[row.number]
    assert row.number in TIMEOUTS


class Model:
    """A drive that follows every controlword, by the table of CiA 402-2."""

    def __init__(self, state: State = State.NOT_READY) -> None:
        self.state = state
        self.last = 0

    def take(self, word: int) -> None:
        rising = word & ~self.last & 0x80
        self.last = word
        if self.state is State.NOT_READY:
            self.state = State.DISABLED
        elif self.state is State.FAULT:
            self.state = State.DISABLED if rising else State.FAULT
        elif self.state is State.FAULT_REACTION:
            self.state = State.FAULT
        elif not word & 2:
            self.state = State.DISABLED
        elif not word & 4:
            self.state = {State.ENABLED: State.QUICK_STOP, State.QUICK_STOP: State.QUICK_STOP}.get(
                self.state, State.DISABLED
            )
        elif self.state is not State.QUICK_STOP:
            low = word & 0xF
            step = {
                (State.DISABLED, 6): State.READY,
                (State.READY, 7): State.SWITCHED_ON,
                (State.SWITCHED_ON, 6): State.READY,
                (State.SWITCHED_ON, 0xF): State.ENABLED,
                (State.ENABLED, 7): State.SWITCHED_ON,
                (State.ENABLED, 6): State.READY,
            }
            self.state = step.get((self.state, low), self.state)


def drive_to(goal: State, model: Model) -> tuple[Drive402, list[State]]:
    machine = Drive402()
    machine.request(goal)
    way = [model.state]
    for cycle in range(20):
        model.take(machine.step(SHOWN[model.state], cycle * 0.004))
        if model.state is not way[-1]:
            way.append(model.state)
    return machine, way


def test_a_drive_is_enabled_one_transition_after_another() -> None:
    machine, way = drive_to(State.ENABLED, Model())
    assert way == [
        State.NOT_READY,
        State.DISABLED,
        State.READY,
        State.SWITCHED_ON,
        State.ENABLED,
    ]
    assert machine.reached
    assert machine.failure is None


@given(
    st.sampled_from(sorted(set(State) - {State.FAULT, State.FAULT_REACTION})),
    st.sampled_from(sorted(HOLDING)),
)
def test_every_state_leads_to_every_goal(start: State, goal: State) -> None:
    machine, way = drive_to(goal, Model(start))
    assert machine.reached
    assert machine.failure is None
    # A quick stop where nothing moves ends with the drive switched off.
    assert way[-1] is goal or (goal is State.QUICK_STOP and way[-1] is State.DISABLED)


@pytest.mark.parametrize("state", [State.DISABLED, State.READY, State.SWITCHED_ON])
def test_a_transition_that_takes_too_long_is_given_up(state: State) -> None:
    machine = Drive402()
    machine.request(State.ENABLED)
    transition = next_transition(state, State.ENABLED)
    assert transition is not None
    word = SHOWN[state] & ~0x10  # no voltage
    assert machine.step(word, 10.0) == transition.command
    assert machine.step(word, 10.0 + TIMEOUTS[transition.number]) == transition.command
    assert machine.failure is None
    assert machine.step(word, 10.1 + TIMEOUTS[transition.number]) == Control.DISABLE_VOLTAGE
    assert machine.goal is State.DISABLED
    assert machine.failure is not None
    assert f"still {state}" in machine.failure.text
    assert "safe torque off" in machine.failure.text


def test_a_transition_downwards_is_never_given_up() -> None:
    machine = Drive402()
    machine.request(State.SWITCHED_ON)
    for now in (0.0, 6.0, 60.0):
        assert machine.step(SHOWN[State.ENABLED], now) == Control.SWITCH_ON
    assert machine.goal is State.SWITCHED_ON
    assert machine.failure is not None


@pytest.mark.parametrize("state", [State.DISABLED, State.READY, State.SWITCHED_ON, State.NOT_READY])
def test_a_drive_that_drops_out_is_not_brought_back(state: State) -> None:
    machine, _ = drive_to(State.ENABLED, Model())
    words = [machine.step(SHOWN[state], 1.0 + 0.004 * n) for n in range(5)]
    assert words == [0] * 5
    assert machine.failure is not None
    assert f"went to {state}" in machine.failure.text


def test_a_drive_that_stops_quickly_by_itself_is_left_to_finish() -> None:
    machine, _ = drive_to(State.ENABLED, Model())
    assert machine.step(SHOWN[State.QUICK_STOP], 1.0) == Control.QUICK_STOP
    assert machine.failure is not None
    assert machine.step(SHOWN[State.DISABLED], 1.1) == Control.DISABLE_VOLTAGE
    assert machine.reached
    assert machine.failure is not None


def test_a_fault_ends_the_way_up_and_stays_until_it_is_reset() -> None:
    machine = Drive402()
    machine.request(State.ENABLED)
    machine.step(SHOWN[State.SWITCHED_ON], 0.0)
    assert [machine.step(SHOWN[State.FAULT], 0.1 * n) for n in range(1, 30)] == [0] * 29
    assert machine.failure is not None
    assert not machine.reached
    machine.reset_fault()
    assert machine.failure is None
    sent = [machine.step(SHOWN[State.FAULT], 3.0 + 0.004 * n) for n in range(6)]
    assert sent == [0, 0, 0, 0x80, 0x80, 0x80]
    assert machine.step(SHOWN[State.DISABLED], 3.1) == 0
    assert machine.reached
    # The next fault is not reset by the last request.
    assert machine.step(SHOWN[State.FAULT], 3.2) == 0
    assert [machine.step(SHOWN[State.FAULT], 3.3 + n) for n in range(3)] == [0, 0, 0]


def test_a_fault_that_stays_is_told() -> None:
    machine = Drive402()
    machine.reset_fault()
    words = [machine.step(SHOWN[State.FAULT], 0.1 * n) for n in range(40)]
    assert words[1] == 0x80
    assert words[-1] == 0
    assert machine.failure is not None
    assert "did not clear" in machine.failure.text


def test_halt_and_the_bits_of_the_mode_are_sent_only_while_enabled() -> None:
    machine = Drive402()
    machine.mode_bits, machine.halt = 0x10, True
    machine.request(State.ENABLED)
    assert machine.step(SHOWN[State.SWITCHED_ON], 0.0) == 0x0F
    assert machine.step(SHOWN[State.ENABLED], 0.0) == 0x11F
    machine.request(State.SWITCHED_ON)
    assert machine.step(SHOWN[State.ENABLED], 0.0) == 0x07


def test_a_statusword_without_a_state_keeps_the_controlword() -> None:
    machine, _ = drive_to(State.ENABLED, Model())
    assert machine.step(0x0201, 1.0) == 0x0F
    assert machine.state is None
    for goal in set(HOLDING) - {State.ENABLED}:  # but never that of a goal which is wanted no more
        machine.request(goal)
        assert machine.step(0x0201, 1.0) == HOLDING[goal]


def test_a_drive_that_shows_no_state_for_long_is_told_to_stop() -> None:
    machine, _ = drive_to(State.ENABLED, Model())
    for now in (1.0, 1.09):
        assert machine.step(0xFFFF, now) == HOLDING[State.ENABLED]
    assert machine.step(SHOWN[State.ENABLED], 1.11) == HOLDING[State.ENABLED]
    assert machine.step(0xFFFF, 1.2) == HOLDING[State.ENABLED], "it counts from the first one"
    assert machine.step(0xFFFF, 1.31) == HOLDING[State.QUICK_STOP]
    assert machine.failure is not None
    assert "shows no state" in machine.failure.text


@given(
    st.lists(
        st.tuples(
            st.integers(0, 0xFFFF),
            st.floats(0.0, 3.0),
            st.sampled_from([None, None, None, "reset", *sorted(HOLDING)]),
        ),
        max_size=60,
    )
)
def test_whatever_a_drive_shows_power_comes_only_as_asked(
    steps: list[tuple[int, float, str | None]],
) -> None:
    """Upward commands are sent only towards a goal, and never once something has failed."""
    machine = Drive402()
    asked: State = State.DISABLED
    now = 0.0
    for word, seconds, order in steps:
        now += seconds
        if order == "reset":
            machine.reset_fault()
            asked = State.DISABLED
        elif order is not None:
            asked = State(order)
            machine.request(asked)
        sent = machine.step(word, now)
        assert sent in (0x00, 0x02, 0x06, 0x07, 0x0F, 0x80)
        assert machine.state is decode(word)
        if sent == 0x0F:
            assert asked is State.ENABLED
            assert machine.failure is None
        if sent == 0x80:
            assert machine.state is State.FAULT or machine.state is None
        if machine.failure is not None and machine.state is State.DISABLED:
            assert sent == 0


def test_only_states_that_a_controlword_leads_to_can_be_wanted() -> None:
    with pytest.raises(ValueError, match="fault"):
        Drive402().request(State.FAULT)
    assert {row.number for row in TRANSITIONS} >= UPWARDS


def test_option_codes_have_words() -> None:
    assert option_text(0x605A, 6) == "quick stop ramp, stay in quick stop"
    assert option_text(0x6007, 3) == "quick stop"
    assert "manufacturer" in option_text(0x605A, -1)
    assert option_text(0x605E, 99) == "reserved (99)"
    assert set(OPTION_CODES) == {0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E}
