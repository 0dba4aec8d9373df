"""The sensor's pages: real ones, wrong ones, hostile ones."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft import units
from crtk_driver_ati_netft.calibration import (
    LONGEST_PAGE,
    Scale,
    numbers,
    read_calibration,
    read_sensor,
)
from crtk_drivers.errors import ProtocolError

GAMMA = {
    "runstat": "0x00000000",
    "runrate": "7000",
    "setcfgsel": "0",
    "setuserfilter": "3",
    "setbias": "-1;2;-3;4;-5;6",
    "cfgnam": "Default",
    "cfgcalsn": "FT27462",
    "cfgfu": "2",
    "scfgfu": "N",
    "cfgtu": "3",
    "scfgtu": "Nm",
    "cfgcpf": "1000000",
    "cfgcpt": "1000000",
    "cfgmr": "330;330;990;30;30;30",
    "cfgtdu": "3",
    "scfgtdu": "mm",
    "cfgtau": "1",
    "scfgtau": "degrees",
    "cfgtfx": "0;0;132.710;0;0;180",
    "comrdte": "Enabled",
    "comrdtrate": "2000",
    "comrdtbsiz": "16",
    "mfgdigsn": "E0123",
    "mfgdigver": "2.2.59",
    "prodname": "ATI Net F/T",
}


def page(tags=None, root="netft", extra="", **changed) -> bytes:
    tags = {**(GAMMA if tags is None else tags), **changed}
    lines = "".join(f"<{name}>{text}</{name}>\n" for name, text in tags.items() if text is not None)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{root}>\n{lines}{extra}</{root}>'.encode()


def test_the_page_of_a_gamma() -> None:
    found = read_sensor(page(), "here")
    assert found.scale == Scale(1e6, 1e6)
    assert found.scale.factors == pytest.approx([1e-6] * 6)
    assert found.product == "ATI Net F/T"
    assert (found.serial, found.firmware) == ("E0123", "2.2.59")
    assert (found.configuration, found.calibration_serial) == ("Default", "FT27462")
    assert found.rated.tolist() == [330, 330, 990, 30, 30, 30]
    assert found.transform == pytest.approx([0, 0, 0.13271, 0, 0, 3.14159265])
    assert found.bias == (-1, 2, -3, 4, -5, 6)
    assert (found.filter_code, found.active_configuration) == (3, 0)
    assert (found.internal_rate, found.rdt_rate, found.buffer_size) == (7000, 2000, 16)
    assert found.rdt_enabled is True
    assert found.status == 0
    assert found.problems == ()


@pytest.mark.parametrize(
    ("force", "torque", "factors"),
    [
        ("N", "Nm", (1e-6, 1e-6)),
        ("N", "N-m", (1e-6, 1e-6)),
        ("N", "N-mm", (1e-6, 1e-9)),
        ("N", "Nmm", (1e-6, 1e-9)),
        ("lbf", "lbf-in", (4.4482216152605e-6, 0.1129848290276167e-6)),
        ("lb", "in-lb", (4.4482216152605e-6, 0.1129848290276167e-6)),
        ("klbf", "lbf-ft", (4.4482216152605e-3, 1.3558179483314e-6)),
        ("kN", "kN-m", (1e-3, 1e-3)),
        ("kgf", "kgf-cm", (9.80665e-6, 0.0980665e-6)),
        ("kg", "kg-cm", (9.80665e-6, 0.0980665e-6)),
        ("gf", "Nm", (9.80665e-9, 1e-6)),
    ],
)
def test_units_become_si(force, torque, factors) -> None:
    texts = {"scfgfu": force, "scfgtu": torque, "cfgfu": None, "cfgtu": None}
    found = read_sensor(page(**texts), "here").scale.factors
    assert found[:3] == pytest.approx([factors[0]] * 3)
    assert found[3:] == pytest.approx([factors[1]] * 3)


def test_codes_of_units_count_where_there_is_no_name() -> None:
    found = read_sensor(page(scfgfu=None, scfgtu="", cfgfu="1", cfgtu="4"), "here").scale
    assert (found.force, found.torque) == pytest.approx((4.4482216152605, 0.001))


def test_rated_loads_are_in_the_units_of_the_page() -> None:
    found = read_sensor(
        page(cfgfu="1", scfgfu="lbf", cfgtu="1", scfgtu="lbf-in", cfgmr="1,2,3 4  5;6"), "here"
    )
    assert found.rated[2] == pytest.approx(3 * 4.4482216152605)
    assert found.rated[5] == pytest.approx(6 * 0.1129848290276167)


def test_an_axia_says_some_things_otherwise() -> None:
    found = read_sensor(
        page(comrdtrate=None, runrate=None, commrdtrate="3956", setrate="7912"), "here"
    )
    assert (found.rdt_rate, found.internal_rate) == (3956, 7912)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"cfgcpf": None}, "cfgcpf is missing"),
        ({"cfgcpt": ""}, "cfgcpt is missing"),
        ({"cfgcpf": "many"}, "cfgcpf is 'many', no number"),
        ({"cfgcpf": "1;2"}, "no number"),
        ({"cfgcpf": "0"}, "not above zero"),
        ({"cfgcpf": "-5"}, "not above zero"),
        ({"cfgcpf": "nan"}, "no number"),
        ({"cfgcpf": "1e999"}, "no number"),
        ({"scfgfu": "stone"}, "'stone'"),
        ({"scfgtu": "furlong"}, "'furlong'"),
        ({"scfgfu": None, "cfgfu": "9"}, "'9'"),
        ({"scfgfu": None, "cfgfu": None}, "missing"),
        ({"cfgcpf": "1e-300"}, "a count would be worth 1e+300 N"),
        ({"cfgcpt": "1e300"}, "a count would be worth 1e-300 N"),
        ({"cfgcpf": "1e308"}, "a count would be worth"),
        ({"cfgfu": "1"}, "cfgfu '1', scfgfu 'N'"),
        ({"scfgtu": "lbf-ft"}, "cfgtu '3', scfgtu 'lbf-ft'"),
        ({"prodname": "ATI Axia80", "cfgfu": "1"}, "cfgfu '1', scfgfu 'N'"),
        ({"extra": "<cfgcpf>600000</cfgcpf>"}, "cfgcpf is there twice"),
        ({"extra": "<scfgtu>Nmm</scfgtu>"}, "scfgtu is there twice"),
        ({"root": "html"}, "holds <html>"),
    ],
)
def test_no_scale_is_better_than_a_wrong_one(changed, message) -> None:
    with pytest.raises(ProtocolError) as caught:
        read_sensor(page(**changed), "http://1.2.3.4/netftapi2.xml")
    assert message in caught.value.message
    assert caught.value.where == "http://1.2.3.4/netftapi2.xml"
    assert caught.value.remedy


def test_an_axia_may_count_its_units_from_0_all_of_them() -> None:
    found = read_sensor(page(prodname="ATI Axia80", cfgfu="1", cfgtu="2"), "here")
    assert (found.scale.force, found.scale.torque) == (1.0, 1.0)


def test_a_tag_that_is_there_twice_with_one_value_is_there() -> None:
    assert read_sensor(page(extra="<cfgcpf>1000000</cfgcpf>"), "here").scale.counts_per_force == 1e6


def test_what_is_not_needed_may_be_nonsense_and_is_told() -> None:
    found = read_sensor(
        page(
            cfgmr="1;2", setbias="x", runrate="fast", comrdte="Perhaps", runstat="0xZZ", cfgtfx=None
        ),
        "here",
    )
    assert found.rated.size == found.transform.size == 0
    assert found.bias == ()
    assert found.internal_rate is found.rdt_enabled is found.status is None
    assert [problem.split()[0] for problem in found.problems] == [
        "cfgmr",
        "setbias",
        "runrate",
        "comrdte",
        "runstat",
    ]
    strange = read_sensor(page(scfgtdu="cubits"), "here")
    assert strange.transform.size == 0
    assert "cubits" in strange.problems[0]


@pytest.mark.parametrize(
    ("tag", "text"),
    [
        ("cfgmr", "0;0;0;0;0;0"),
        ("cfgmr", "-1;330;990;30;30;30"),
        ("cfgmr", "1e308;330;990;30;30;30"),
        ("cfgmr", "nan;330;990;30;30;30"),
        ("setbias", "1e308;2;3;4;5;6"),
        ("runrate", "-7000"),
        ("runrate", "0x" + "f" * 5000),
        ("runrate", "9" * 5000),
        ("comrdtrate", "1e308"),
        ("comrdtbsiz", "41"),
        ("setcfgsel", "16"),
        ("setuserfilter", "0.5"),
        ("runstat", "0x100000000"),
    ],
)
def test_what_cannot_be_counts_as_unknown(tag, text) -> None:
    found = read_sensor(page(**{tag: text}), "here")
    assert [problem.split()[0] for problem in found.problems] == [tag]


def test_names_are_one_short_line() -> None:
    assert read_sensor(page(prodname="ATI\n\t Axia" + "x" * 1000), "here").product[:12] == (
        "ATI Axiaxxxx"
    )
    assert len(read_sensor(page(prodname="x" * 1000), "here").product) == 100


def test_a_page_with_the_scale_alone_is_enough() -> None:
    found = read_sensor(
        page({"cfgcpf": "10000", "cfgcpt": "100000", "scfgfu": "N", "scfgtu": "Nm"}), "here"
    )
    assert found.scale.factors == pytest.approx([1e-4] * 3 + [1e-5] * 3)
    assert found.rdt_rate is None
    assert found.problems == ()


BOMB = b"""<?xml version="1.0"?><!DOCTYPE netft [<!ENTITY a "aaaaaaaaaa">
<!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">
<!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;&c;&c;"><!ENTITY e "&d;&d;&d;&d;&d;&d;&d;&d;&d;&d;">
<!ENTITY f "&e;&e;&e;&e;&e;&e;&e;&e;&e;&e;">]><netft><cfgcpf>&f;</cfgcpf></netft>"""
OUTSIDE = b"""<?xml version="1.0"?><!DOCTYPE netft [<!ENTITY x SYSTEM "file:///etc/passwd">]>
<netft><cfgcpf>&x;</cfgcpf></netft>"""
DEEP = b"<netft>" + b"<a>" * 30000 + b"</a>" * 30000 + b"</netft>"


@pytest.mark.parametrize(
    "hostile",
    [
        b"",
        b"\x00" * 100,
        b"<netft>",
        b"<netft></netft></netft>",
        BOMB,
        OUTSIDE,
        b'<!DOCTYPE netft SYSTEM "http://example.org/x.dtd"><netft/>',
        b'<?xml version="1.0" encoding="nonsense"?><netft/>',
        b'<?xml version="1.0" encoding="utf-16"?><netft/>',
        b"<netft>" + b"<a/>" * 200000 + b"</netft>",
        page() + b" " * LONGEST_PAGE,
        DEEP,
    ],
)
def test_hostile_pages_are_refused(hostile: bytes) -> None:
    with pytest.raises(ProtocolError):
        read_sensor(hostile, "here")


@pytest.mark.parametrize("hostile", [BOMB, OUTSIDE])
def test_entities_are_not_even_read(hostile: bytes) -> None:
    with pytest.raises(ProtocolError, match="DTDForbidden"):
        read_sensor(hostile, "here")


@given(st.binary(max_size=300))
def test_any_bytes_are_a_page_or_an_error_of_ours(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        read_sensor(data, "here")


@given(
    st.dictionaries(st.sampled_from(sorted(GAMMA)), st.text("0123456789;.-xeN<&nm", max_size=12))
)
def test_any_texts_are_values_or_an_error_of_ours(texts) -> None:
    try:
        found = read_sensor(page(**texts), "here")
    except ProtocolError:
        return
    assert (found.scale.factors > 0.0).all()


def test_a_calibration_page() -> None:
    tags = {
        "calsn": "FT1", "calpn": "SI-330-30", "calfam": "Gamma", "caldt": "2026/01/01",
        "calfu": "2", "scalfu": "N", "caltu": "3", "scaltu": "Nm",
        "calmr": "330;330;990;30;30;30", "calcpf": "1000000", "calcpt": "1000000",
    }  # fmt: skip
    found = read_calibration(page(tags, root="netftCalibration"), "here")
    assert (found.serial, found.part, found.family) == ("FT1", "SI-330-30", "Gamma")
    assert found.rated.tolist() == [330, 330, 990, 30, 30, 30]
    with pytest.raises(ProtocolError, match="holds <netft>"):
        read_calibration(page(), "here")


@pytest.mark.parametrize("text", ["1;2;3", "1,2,3", "1 2 3", " 1; 2 ;3 ", "1;;2,,3"])
def test_lists_are_separated_in_three_ways(text) -> None:
    assert numbers(text) == (1.0, 2.0, 3.0)


def test_every_unit_is_found_by_its_own_name_and_by_its_code() -> None:
    for table in (units.FORCE, units.TORQUE, units.LENGTH, units.ANGLE):
        for code, (name, value) in enumerate(table.items(), start=1):
            assert units.factor(table, name.upper()) == value
            assert units.factor_of_code(table, code) == value
        assert units.factor(table, "nonsense") is None
        assert units.factor_of_code(table, 0) is None
        assert units.factor_of_code(table, len(table) + 1) is None
