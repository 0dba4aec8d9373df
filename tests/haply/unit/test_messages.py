"""Messages of the service: known ones, and hostile ones."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_haply.messages import FULL_STATE, MOST, ForceMessage, Grip, parse

XYZ = {"x": 0.0, "y": 0.0, "z": 0.0}
INVENTORY = b"""
{"session_id": 7,
 "inverse3": [
  {"device_id": "049D",
   "config": {"type": "inverse3", "port": "COM12",
    "device_info": {"major_version": 7, "minor_version": 4, "id": "049D", "device_type": 4},
    "gravity_compensation": {"enabled": true, "scaling_factor": 1.0}, "handedness": "right",
    "filters": {"force_gate": {"gain": 0.3}, "damping": {"scalar": 0.0}}},
   "state": {
    "cursor_position": {"x": 0.0, "y": -0.12, "z": 0.15},
    "cursor_velocity": {"x": 0.0, "y": 0.5, "z": 0.0},
    "angular_position": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
    "current_cursor_force": {"x": 0, "y": 0.0, "z": 1.5},
    "control_domain": "cartesian", "control_mode": "idle"},
   "status": {"calibrated": true}}],
 "wireless_verse_grip": [
  {"device_id": "61548",
   "state": {"orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
    "buttons": {"a": true, "b": false, "c": false}, "battery_level": 0.75},
   "status": {"awake": true}}]}
"""
"""As the manual of 3.5 has it, shortened; the grip as Isaac Lab and sawHaplyService read it."""
JHU_MOCK = json.dumps(
    {
        "inverse3": [
            {
                "device_id": "0",
                "state": {
                    "cursor_position": {"x": 0.0, "y": 0.05, "z": 0.0},
                    "cursor_velocity": XYZ,
                    "angular_position": XYZ,
                    "angular_velocity": XYZ,
                },
            }
        ]
    }
).encode()
"""As sawHaplyService's own test service tells it: no status, no configuration, no grips."""


def test_the_first_message_of_the_manual() -> None:
    told = parse(INVENTORY)
    assert told.arms is not None
    arm = told.arms["049D"]
    assert (arm.position, arm.velocity, arm.force) == (
        (0.0, -0.12, 0.15),
        (0.0, 0.5, 0.0),
        (0.0, 0.0, 1.5),
    )
    assert (arm.is_calibrated, arm.firmware) == (True, "7.4")
    grip = told.grips["61548"]
    assert (grip.kind, grip.pressed, grip.battery, grip.is_awake) == (
        "wireless_verse_grip",
        frozenset("a"),
        0.75,
        True,
    )
    assert grip.orientation == pytest.approx((0.0, 0.0, 0.6, 0.8))


def test_a_service_that_tells_no_status() -> None:
    told = parse(JHU_MOCK)
    assert told.arms is not None
    assert told.arms["0"].is_calibrated
    assert told.arms["0"].force is None
    assert told.grips == {}


@pytest.mark.parametrize(("told", "calibrated"), [(0, False), (1, False), (2, True), (3, True)])
def test_older_services_tell_a_number(told: int, calibrated: bool) -> None:
    message = json.loads(JHU_MOCK)
    message["inverse3"][0]["state"]["calibration_state"] = told
    arms = parse(json.dumps(message).encode()).arms
    assert arms is not None
    assert arms["0"].is_calibrated is calibrated


def test_forces_as_the_clients_send_them() -> None:
    grip = Grip('6"1', "wireless_verse_grip")
    sent = json.loads(ForceMessage("049D", grip, "values").of((0.5, -1e-20, 3.0)))
    assert sent == {
        "inverse3": [
            {
                "device_id": "049D",
                "commands": {"set_cursor_force": {"values": {"x": 0.5, "y": -1e-20, "z": 3.0}}},
            }
        ],
        "wireless_verse_grip": [{"device_id": '6"1', "commands": {"probe_orientation": {}}}],
    }
    sent = json.loads(ForceMessage("049D", None, "vector").of((0.0, 0.0, 0.0)))
    assert sent == {
        "inverse3": [{"device_id": "049D", "commands": {"set_cursor_force": {"vector": XYZ}}}]
    }
    assert json.loads(FULL_STATE) == {"session": {"force_render_full_state": {}}}


def _with(path: str, value: Any) -> bytes:
    message = json.loads(INVENTORY)
    at: Any = message
    *way, last = path.split("/")
    for key in way:
        at = at[int(key)] if isinstance(at, list) else at[key]
    at[last] = value
    return json.dumps(message).encode()


POSITION = "inverse3/0/state/cursor_position"
ORIENTATION = "wireless_verse_grip/0/state/orientation"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "Expecting value"),
        (INVENTORY[: len(INVENTORY) // 2], "Expecting|Unterminated"),
        (b"\xff\xfe", "codec|Expecting"),
        (b"[" * 100_000, "nested"),
        (b"[1]", "no object"),
        (_with(f"{POSITION}/x", math.nan), "NaN is no number"),
        (_with(f"{POSITION}/x", -math.inf), "-Infinity is no number"),
        (INVENTORY.replace(b"-0.12", b"1e999"), "cannot be"),
        (INVENTORY.replace(b"-0.12", b"9" * 400), "cannot be"),
        (_with(f"{POSITION}/y", MOST * 1.01), "cannot be"),
        (_with(f"{POSITION}/y", True), "no number"),
        (_with(f"{POSITION}/y", "0.1"), "no number"),
        (_with(f"{POSITION}/y", None), "no number"),
        (_with(POSITION, [0, 0, 0]), "no object"),
        (_with(f"{ORIENTATION}/w", 0.0), "norm"),
        (_with(ORIENTATION, XYZ), "no number"),
        (_with("inverse3", {"device_id": "049D"}), "no list"),
        (_with("inverse3", [3]), "no list of objects"),
        (_with("inverse3/0/device_id", 5), "device_id"),
        (_with("inverse3/0/device_id", ""), "device_id"),
        (_with("inverse3/0/status/calibrated", "yes"), "calibrated"),
        (_with("wireless_verse_grip/0/status/awake", 1), "awake"),
    ],
)
def test_what_is_none_is_refused_with_a_reason(text: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        parse(text)
    assert str(caught.value)


def test_another_service_has_no_list() -> None:
    assert parse(b'{"jsonrpc": "2.0", "result": "pong"}').arms is None


@given(st.integers(0, len(INVENTORY) - 1), st.binary(max_size=3))
def test_a_damaged_message_is_read_or_refused(at: int, put: bytes) -> None:
    try:
        told = parse(INVENTORY[:at] + put + INVENTORY[at + 1 :])
    except ValueError:
        return
    for arm in (told.arms or {}).values():
        assert all(map(math.isfinite, (*arm.position, *arm.velocity)))


_JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)
_PLACES = (
    "inverse3",
    "inverse3/0/state",
    "inverse3/0/status",
    "inverse3/0/config",
    "inverse3/0/config/device_info",
    POSITION,
    "inverse3/0/state/current_cursor_force",
    "wireless_verse_grip",
    "wireless_verse_grip/0/state/buttons",
    "wireless_verse_grip/0/state/battery_level",
    ORIENTATION,
)


@given(st.sampled_from(_PLACES), _JSON)
def test_any_json_in_any_place_is_read_or_refused(place: str, value: Any) -> None:
    with suppress(ValueError):
        parse(_with(place, value))


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3))
def test_every_force_is_sent_to_the_last_bit(force: tuple[float, float, float]) -> None:
    sent = json.loads(ForceMessage("0", None, "values").of(force))
    values = sent["inverse3"][0]["commands"]["set_cursor_force"]["values"]
    assert tuple(values[axis] for axis in "xyz") == force
