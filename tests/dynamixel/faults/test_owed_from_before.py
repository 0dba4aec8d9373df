"""Replies that servos still owe whoever used the line before: never an answer to the opening that follows."""

import threading
import time

import pytest

from crtk_driver_dynamixel import PLUGIN
from crtk_driver_dynamixel.bus import SETTLING
from crtk_driver_dynamixel.control_tables import control_table
from crtk_driver_dynamixel.models import MODELS
from crtk_driver_dynamixel.readings import HEALTH, MEASURED, SLOW
from crtk_driver_dynamixel.replies import ServoSilent
from crtk_driver_dynamixel.servo_state import ServoState
from rigs.dynamixel_bench import PATIENT, PING, configuration, opened, patient, sim_for
from rigs.waiting import LONG, eventually

NEWEST = 255
VOLTAGE = ("present_input_voltage", "present_voltage")


@pytest.mark.parametrize("length", [2, 3])
@pytest.mark.parametrize("model", ["xm430-w350", "mx-28", "xl-320"])
def test_a_late_reply_of_before_identifies_no_servo(model, length):
    """A voltage and a temperature, 3 bytes, are as long as the answer to a ping: model number 120."""
    values = {**PATIENT, "silent_timeout": 9.0, "sample_timeout": 10.0, "fast_read": False}
    values["joints"] = {"pan": {"id": 1, "model": model}}
    with sim_for(values) as sim, patient():
        with opened(sim, values) as before:
            found = dict(before.link.states[0].values)
            address = before.link.states[0].table.first(VOLTAGE).address
            (bus,) = before.link._buses.values()
            sim.control.inject("stall")
            with pytest.raises(ServoSilent):
                bus.read(1, address, length, attempts=1)
        sim.control.inject(
            "late", seconds=0.1
        )  # so that what was owed comes alone, before any answer
        mark = sim.control.status()["instructions"]

        def is_pinged():
            return any(each["code"] == PING for each in sim.control.trace(after=mark))

        def let_come():
            eventually(is_pinged, "it is asked who it is")
            sim.control.clear("stall")

        release = threading.Thread(target=let_come)
        release.start()
        device = PLUGIN.create(configuration(sim, values))
        try:
            device.open(time.monotonic() + LONG)
            assert dict(device.link.states[0].values) == found
        finally:
            release.join()
            device.close()


@pytest.mark.parametrize("model", MODELS)
def test_nothing_else_is_as_long_as_what_settles(model):
    table = control_table(MODELS[model].number, NEWEST, protocol=MODELS[model].family.protocol)
    assert max(table[name].end for name in table) >= max(SETTLING)
    lengths = {length for _, length, _ in ServoState(None, table, NEWEST).blocks()}
    for roles in (MEASURED, HEALTH, *SLOW):
        items = [item for names in roles.values() if (item := table.first(names)) is not None]
        if items:
            first, end = min(i.address for i in items), max(i.end for i in items)
            lengths.add(end - first)
    assert not lengths & set(SETTLING)
