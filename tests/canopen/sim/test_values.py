"""Values with which a simulated drive could not go on: refused with a reason, and nothing has changed."""

from contextlib import suppress

import pytest

from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.canopen.aborts import SdoAbort
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.fitting import like
from crtk_sim_backends.canopen.personality import PERSONALITIES
from crtk_sim_backends.control import ControlRefused
from rigs.canopen_drive import Aborted, Bench

VALUE, HIGH, LOW = 0x0609_0030, 0x0609_0031, 0x0609_0032
READ_ONLY = 0x0601_0002

USELESS = [
    *((index, sub, 0, "I", LOW) for index in (0x608F, 0x6091, 0x6092, 0x6096) for sub in (1, 2)),
    *((index, 0, 0, "I", LOW) for index in (0x6075, 0x6076, 0x6083, 0x6084, 0x6085, 0x60C6)),
    (0x60C2, 1, 0, "B", LOW),
    (0x60C2, 2, 1, "b", HIGH),
    (0x60C2, 2, -7, "b", LOW),
    (0x605D, 0, 0, "h", LOW),
    (0x605A, 0, 9, "h", HIGH),
    (0x6060, 0, 2, "b", VALUE),
    (0x6098, 0, 15, "b", VALUE),
    (0x60A8, 0, 0x7F10_0000, "I", READ_ONLY),  # 10^127 rad
]
"""Object, a value with which the drive cannot work, and how an SDO is refused (CiA 301, 7.2.4.3.17)."""


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(nodes=1, terminals=0) as sim:
        yield sim


@pytest.mark.parametrize(("index", "sub", "value", "layout", "code"), USELESS)
def test_useless_values_are_refused_with_their_code(index, sub, value, layout, code):
    bench = Bench()
    before = dict(bench.drive.dictionary.values)
    assert bench.abort_of(bench.write, index, sub, value, layout) == code
    assert bench.drive.dictionary.values == before


@pytest.mark.parametrize(("index", "sub", "value", "layout", "code"), USELESS)
def test_the_control_socket_refuses_them_too(sim, index, sub, value, layout, code):
    where = {"node": 1, "index": index, "sub": sub}
    before = sim.control.call("object", **where)
    with pytest.raises(ControlRefused, match=f"{index:04X}:{sub} cannot be {value}: it is"):
        sim.control.call("object", **where, value=value)
    assert sim.control.call("object", **where) == before
    assert sim.control.status()["drives"]["1"]["nmt"] == "pre_operational"


@pytest.mark.parametrize(
    ("value", "reason"), [(1.5, "whole number"), (1 << 32, "cannot be"), (-1, "cannot be")]
)
def test_a_number_of_another_type_is_refused(sim, value, reason):
    with pytest.raises(ControlRefused, match=reason):
        sim.control.call("object", node=1, index=0x6065, value=value)


def used(bench):
    """Read all that there is, and go through each mode."""
    dictionary = bench.drive.dictionary
    for index, sub in dictionary.variables:
        with suppress(SdoAbort):
            dictionary.read(index, sub)
    for mode in (1, 3, 4, 6, 7, 8, 9, 10):
        with suppress(Aborted):
            bench.mode(mode)
        for index, layout in ((0x607A, "i"), (0x60FF, "i"), (0x6071, "h")):
            with suppress(Aborted):
                bench.write(index, 0, 100, layout)
        for word in (0x80, 0x06, 0x07, 0x0F, 0x1F, 0x10F, 0x02):
            with suppress(Aborted):
                bench.control(word)
            bench.run(0.004)


MAKES = {name: {"personality": PERSONALITIES[name]} for name in ("standard", "epos4", "zlac8015d")}


@pytest.mark.parametrize("name", [*MAKES, "like"])
def test_no_value_ends_a_drive(name):
    """Each number of the drive gets its ends, 0, and what is beyond, past the bus."""
    config = MAKES.get(name) or {"like": like(str(PUBLISHED))}
    dictionary = Bench(**config).drive.dictionary
    for entry in dictionary.objects.values():
        for sub, variable in entry.entries.items():
            if not variable.type.size:
                continue
            low, high = dictionary.range_of((entry.index, sub))
            least, most = variable.type.limits
            for value in sorted({0, 1, low, low - 1, high, high + 1, least, most}):
                bench = Bench(**config)
                with suppress(SdoAbort):
                    bench.drive.dictionary.force(entry.index, sub, value)
                    used(bench)
