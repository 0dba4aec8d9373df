"""Configuration of the simulated drives and of the bus on which they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import yaml
from typing_extensions import override

from crtk_sim_backends.can.config import SimConfig as BusConfig
from crtk_sim_backends.canopen.defects import AxisDefects
from crtk_sim_backends.canopen.drive import DriveConfig
from crtk_sim_backends.canopen.fitting import like
from crtk_sim_backends.canopen.objects import MODES, MOST_AXES, MOST_PDOS, PDOS
from crtk_sim_backends.canopen.personality import PERSONALITIES, TORQUE_UNITS
from crtk_sim_backends.canopen.plant import MotorConfig
from crtk_sim_backends.defects import defects_of, read_defects
from crtk_sim_backends.faults import FaultError, Parameter, unknown
from crtk_sim_backends.options import ConfigError, check_choice, check_file, check_range, option

_HIGHEST_NODE: Final = 127
_KEYS: Final = ("personality", "serial", "motors", "modes", "from_eds")


@dataclass(frozen=True, kw_only=True)
class SimConfig(BusConfig):
    """Options of simulated drives; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    nodes: int = option(6, "how many drives there are")
    first_node: int = option(1, "node-ID of the first drive; the others follow")
    axes: int = option(1, "axes of each drive (CiA 402-2: objects of axis n at +0x800 n)")
    personality: str = option("standard", "make of the drives", tuple(PERSONALITIES))
    modes: str = option(
        "", "modes of operation that the drives have, such as pp,pv,hm; all if empty"
    )
    pdos: int = option(PDOS, "PDOs of each direction that each drive has")
    drives: str = option("", "file (YAML) with motors and makes of single drives, by node-ID")
    from_eds: str = option("", "EDS file of a real drive that the drives are like")
    eds: str = option("", "where to write the EDS of the drives")
    defects: str = option(
        "",
        "what is wrong with drives, such as 'position_noise=1e-3,joints=2+3;backlash=0.01,joints=5'",
    )
    socketcand_port: int = option(0, "TCP port of the socketcand server; 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("axes", self.axes, 1, MOST_AXES)
        check_choice("personality", self.personality, PERSONALITIES, "make")
        if not 1 <= self.first_node <= _HIGHEST_NODE or self.nodes < 0:
            raise ConfigError(
                f"first_node must lie in [1, {_HIGHEST_NODE}] and nodes be at least 0, "
                f"not {self.first_node} and {self.nodes}"
            )
        if self.first_node + self.nodes - 1 > _HIGHEST_NODE:
            raise ConfigError(
                f"nodes: {self.nodes} from node-ID {self.first_node} on go beyond {_HIGHEST_NODE}"
            )
        check_range("pdos", self.pdos, 1, MOST_PDOS)
        _modes("modes", self.modes.split(",") if self.modes else MODES.values())
        check_file("drives", self.drives)
        check_file("from_eds", self.from_eds)
        _ = self.wrong

    @property
    def wrong(self) -> tuple[AxisDefects, ...]:
        """What `defects` says."""
        return read_defects(AxisDefects, self.defects)

    @cached_property
    def common(self) -> DriveConfig:
        """What each drive is for which the file says nothing else.

        Raises:
            ConfigError: the EDS is not one of a CiA 402 drive, or has another number of axes.
        """
        config = DriveConfig(
            (MotorConfig(),) * self.axes,
            personality=PERSONALITIES[self.personality],
            modes=_modes("modes", self.modes.split(",") if self.modes else MODES.values()),
            pdos=self.pdos,
        )
        if not self.from_eds:
            return config
        return _like(config, self.from_eds, own_motors=self.axes != 1)


def _like(config: DriveConfig, path: str, *, own_motors: bool) -> DriveConfig:
    """Return a drive that is like the one of an EDS.

    Args:
        path: of the EDS.
        own_motors: the configuration says how many motors there are; else there is one for each axis.

    Raises:
        ConfigError: the EDS is not one of a CiA 402 drive, or has another number of axes.
    """
    found = like(path, config.modes)
    axes = len(found.modes)
    if own_motors and len(config.motors) != axes:
        raise ConfigError(f"{path} has {axes} axes, and there are {len(config.motors)} motors")
    motors = config.motors if own_motors else (MotorConfig(),) * axes
    make = config.personality
    if found.sheet.vendor in TORQUE_UNITS and (0x6076, 0) in found.sheet.given:
        make = replace(make, torque_unit=TORQUE_UNITS[found.sheet.vendor])
    return replace(config, motors=motors, like=found, personality=make)


def _modes(where: str, names: Iterable[object]) -> frozenset[int]:
    """Return the numbers of modes that are given by their names.

    Raises:
        ConfigError: there is no such mode.
    """
    numbers = {name.lower(): number for number, name in MODES.items()}
    given = [str(name).strip().lower() for name in names]
    for name in given:
        if name not in numbers:
            raise ConfigError(f"{where}: {unknown('mode', name, numbers)}")
    return frozenset(numbers[name] for name in given)


def drive_configs(config: SimConfig) -> dict[int, DriveConfig]:
    """Return the drives by node-ID: the common ones, changed or added to by the file `drives`.

    The file is a mapping; each entry may have `personality`, `serial`, `modes` (a list), and
    `motors`, a list with one mapping of fields of :class:`MotorConfig` for each axis, and `from_eds`, the EDS
    of a real drive that it is like (a path from where the file is)::

        3: {personality: plain, modes: [pp, hm], motors: [{pendulum: 0.2, gear: 100}]}
        4: {from_eds: elsewhere.eds}

    Raises:
        ConfigError: the file is wrong, with the node-ID and the field.
    """
    return {
        node: replace(drive, defects=defects_of(config.wrong, node))
        for node, drive in _drives(config).items()
    }


def _drives(config: SimConfig) -> dict[int, DriveConfig]:
    last = config.first_node + config.nodes
    result = dict.fromkeys(range(config.first_node, last), config.common)
    if not config.drives:
        return result
    try:
        entries = yaml.safe_load(Path(config.drives).read_text()) or {}
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"drives: cannot read {config.drives}: {error}") from error
    if not isinstance(entries, Mapping):
        raise ConfigError(f"{config.drives}: expected a mapping of node-IDs")
    for node, entry in entries.items():
        where = f"{config.drives}: node {node}"
        if not isinstance(node, int) or not 1 <= node <= _HIGHEST_NODE:
            raise ConfigError(f"{where}: a node-ID lies in [1, {_HIGHEST_NODE}]")
        if not isinstance(entry, Mapping):
            raise ConfigError(f"{where}: expected a mapping")
        base = result.get(node, config.common)
        result[node] = _drive(where, entry, base, Path(config.drives).parent)
    return result


def _drive(where: str, entry: Mapping[str, Any], base: DriveConfig, folder: Path) -> DriveConfig:
    for name in entry:
        if name not in _KEYS:
            raise ConfigError(f"{where}: {unknown('key', name, _KEYS)}")
    make = entry.get("personality", base.personality.name)
    if make not in PERSONALITIES:
        raise ConfigError(f"{where}: {unknown('make', make, PERSONALITIES)}")
    serial = entry.get("serial", base.serial)
    if serial is not None and not (isinstance(serial, int) and 0 <= serial < 1 << 32):
        raise ConfigError(f"{where}: serial must be a number of 32 bits, not {serial!r}")
    motors = base.motors
    if "motors" in entry:
        given = entry["motors"]
        if not isinstance(given, list) or not 1 <= len(given) <= MOST_AXES:
            raise ConfigError(f"{where}: motors must be a list of 1 to {MOST_AXES}")
        motors = tuple(_motor(f"{where}, motor {n}", motor) for n, motor in enumerate(given))
    modes = base.modes
    if "modes" in entry:
        if not isinstance(entry["modes"], list):
            raise ConfigError(f"{where}: modes must be a list")
        modes = _modes(f"{where}: modes", entry["modes"])
    result = DriveConfig(motors, serial, PERSONALITIES[make], modes, base.pdos)
    if base.like is None and "from_eds" not in entry:
        return result
    if "from_eds" not in entry:
        assert base.like is not None
        return _like(result, base.like.sheet.path, own_motors=True)
    path = entry["from_eds"]
    if not isinstance(path, str):
        raise ConfigError(f"{where}: from_eds must be the path of a file, not {path!r}")
    return _like(result, str(folder / path), own_motors="motors" in entry)


_MOTOR: Final[dict[str, Parameter]] = {
    "inertia": Parameter(float, minimum=1e-7, maximum=1.0),
    "viscous": Parameter(float, minimum=0.0, maximum=1.0),
    "coulomb": Parameter(float, minimum=0.0, maximum=100.0),
    "gravity": Parameter(float, minimum=-100.0, maximum=100.0),
    "pendulum": Parameter(float, minimum=-100.0, maximum=100.0),
    "gear": Parameter(float, minimum=0.01, maximum=10_000.0),
    "brake": Parameter(bool),
    "negative_limit": Parameter(float, minimum=-30_000.0, maximum=30_000.0),
    "positive_limit": Parameter(float, minimum=-30_000.0, maximum=30_000.0),
    "home": Parameter(list, minimum=-30_000.0, maximum=30_000.0, length=2),
    "stops": Parameter(list, minimum=-30_000.0, maximum=30_000.0, length=2),
    "start": Parameter(float, minimum=-30_000.0, maximum=30_000.0),
}


def _motor(where: str, entry: object) -> MotorConfig:
    if not isinstance(entry, Mapping):
        raise ConfigError(f"{where}: expected a mapping")
    for name in entry:
        if name not in _MOTOR:
            raise ConfigError(f"{where}: {unknown('field', name, _MOTOR)}")
    try:
        fields = {name: _MOTOR[name].check(where, name, value) for name, value in entry.items()}
    except FaultError as error:
        raise ConfigError(str(error)) from error
    return MotorConfig(**fields)
