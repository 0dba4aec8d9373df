"""The operating-state table, cell by cell."""

import pytest

from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.state import OperatingState, StateCommand, parse_command, target_of

INVALID = "invalid"
# As the specification and facts/crtk.md have it.
TABLE = """
           enable   disable   pause    resume   home     unhome
DISABLED   ENABLED  DISABLED  invalid  invalid  invalid  DISABLED
ENABLED    ENABLED  DISABLED  PAUSED   invalid  ENABLED  ENABLED
PAUSED     invalid  DISABLED  PAUSED   ENABLED  invalid  PAUSED
FAULT      ENABLED  DISABLED  invalid  invalid  invalid  FAULT
"""
HEADER, *ROWS = (line.split() for line in TABLE.strip().splitlines())
CELLS = [
    (row[0], command, target)
    for row in ROWS
    for command, target in zip(HEADER, row[1:], strict=True)
]


@pytest.mark.parametrize(("state", "command", "target"), CELLS)
def test_cell(state: str, command: str, target: str) -> None:
    if target == INVALID:
        with pytest.raises(CommandRefused) as caught:
            target_of(OperatingState(state), StateCommand(command))
        assert caught.value.reason is Reason.INVALID_TRANSITION
        assert f"{command} is invalid in {state}" in caught.value.message
        valid = [c for s, c, t in CELLS if s == state and t != INVALID]
        assert caught.value.remedy == f"From {state}: {', '.join(valid)}."
    else:
        assert target_of(OperatingState(state), StateCommand(command)) is OperatingState(target)


def test_the_table_above_is_complete() -> None:
    assert {(s, c) for s, c, _ in CELLS} == {(s, c) for s in OperatingState for c in StateCommand}


def test_no_command_leads_to_fault_from_elsewhere() -> None:
    assert {s for s, _, target in CELLS if target == "FAULT"} == {"FAULT"}


def test_parse_is_exact() -> None:
    assert parse_command("enable") is StateCommand.ENABLE
    for text in ("ENABLE", "enable ", "", "enabled", "None"):
        with pytest.raises(CommandRefused, match="is not a state command"):
            parse_command(text)
    with pytest.raises(CommandRefused):
        parse_command(None)  # type: ignore[arg-type]
