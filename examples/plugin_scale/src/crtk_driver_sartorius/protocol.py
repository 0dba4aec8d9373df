"""The scale's protocol as values: bytes in, messages out. No port, no clock (see the README)."""

from dataclasses import dataclass

from crtk_drivers.kit import LineDecoder

ASK, TARE = b"\x1bP\r\n", b"\x1bT\r\n"
KG = {"mg": 1e-6, "g": 1e-3, "kg": 1.0}


@dataclass(frozen=True, slots=True)
class Weight:
    """What lies on it, in its unit, which is empty while that is not at rest; None: it cannot weigh it."""

    value: float | None
    unit: str


def decoder() -> LineDecoder[Weight]:
    """Return what turns bytes, cut anywhere, into weights."""
    return LineDecoder(parse, end=b"\r\n", longest=20)


def parse(line: str) -> Weight:
    """Return the weight of a line of 14 characters; it raises ValueError if it is none."""
    if len(line) == 14 and line.strip() in ("High", "Low"):
        return Weight(None, "")
    sign, number, unit = line[:1], line[1:10].strip(), line[10:].strip()
    if len(line) != 14 or sign not in "+- " or unit not in ("", *KG) or not number[:1].isdecimal():
        raise ValueError("no weight")
    return Weight(float(sign.strip() + number), unit)
