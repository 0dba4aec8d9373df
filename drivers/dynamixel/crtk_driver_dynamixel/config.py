"""Configuration of a servo chain: keys, defaults, units and bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from crtk_driver_dynamixel import arms
from crtk_driver_dynamixel.gripper import Finger, Jaw, Linear, SliderCrank
from crtk_driver_dynamixel.groups import MOST_GAPS
from crtk_driver_dynamixel.models import Model, OperatingMode, model_named
from crtk_drivers.config import BehindConfig, DeviceConfig, Settings
from crtk_drivers.kit.serial_server import PortName

MAIN_BUS = "main"
"""Name of the bus of a chain that has only one."""

Id = Annotated[int, Field(ge=0, le=252)]
"""Id of a servo on its bus."""

Gain = Annotated[int, Field(ge=0, le=32767)]

PositionMode = Literal["position", "extended_position", "current_based_position"]

OPERATING_MODES: dict[PositionMode, OperatingMode] = {
    "position": OperatingMode.POSITION,
    "extended_position": OperatingMode.EXTENDED_POSITION,
    "current_based_position": OperatingMode.CURRENT_BASED_POSITION,
}


class BusConfig(Settings):
    """One serial line."""

    port: PortName = Field(
        default="",
        max_length=250,
        description="Serial port; a name under /dev/serial/by-id stays the same when it is plugged again. "
        "Or socket://HOST:PORT of a server that passes bytes on as they are.",
    )
    baud: int = Field(
        default=1_000_000,
        ge=9600,
        le=10_500_000,
        description="In bit/s. That of a server is set there, and given here for the time on the wire.",
    )


class GainsConfig(Settings):
    """Control gains, as the registers of the same names hold them; null leaves the servo's own."""

    position_p: Gain | None = Field(default=None, description="Position P Gain (84).")
    position_i: Gain | None = Field(default=None, description="Position I Gain (82).")
    position_d: Gain | None = Field(default=None, description="Position D Gain (80).")
    velocity_p: Gain | None = Field(default=None, description="Velocity P Gain (78).")
    velocity_i: Gain | None = Field(default=None, description="Velocity I Gain (76).")
    feedforward_1st: Gain | None = Field(default=None, description="Feedforward 1st Gain (90).")
    feedforward_2nd: Gain | None = Field(default=None, description="Feedforward 2nd Gain (88).")


class ShadowConfig(Settings):
    """Another servo on the same joint."""

    id: Id = Field(description="Id of the servo, on the bus of the joint.")
    model: str = Field(
        default="", max_length=40, description="Model; that of the joint's first servo if empty."
    )
    sign: Literal[1, -1] = Field(
        description="1 or -1, as for the joint's first servo: the other one where they face each other."
    )
    offset: float | None = Field(
        default=None,
        description="Position of the joint at the middle count of this servo, in rad; that of the "
        "first servo if null.",
    )
    follow: Literal["goals", "secondary_id", "cable"] = Field(
        default="goals",
        description="How it follows: by goals of its own; by taking those of the first servo (register "
        "Secondary ID), for which it counts as that does; or by the synchronisation cable of the 540 models.",
    )
    reverse: bool = Field(
        default=False,
        description="The servo counts the other way (Drive Mode, bit 0): written when it differs.",
    )

    @field_validator("model")
    @classmethod
    def _known(cls, name: str) -> str:
        return name and model_named(name).name


class ServoConfig(Settings):
    """What a joint and a gripper have in common: a servo, or several that act as one."""

    id: Id = Field(description="Id of the servo.")
    model: str = Field(max_length=40, description="Model of the servo, for example xm430-w350.")
    bus: str = Field(default=MAIN_BUS, max_length=64, description="Bus that it is on.")
    protocol: Literal[1, 2] | None = Field(
        default=None, description="Protocol that it speaks; that of its model if null."
    )
    sign: Literal[1, -1] = Field(
        default=1, description="-1 if the joint turns against the counts of the servo."
    )
    offset: float = Field(
        default=0.0,
        description="Position of the joint at the middle count of the servo (2048), in rad.",
    )
    gear: float = Field(
        default=1.0, gt=0.0, le=10_000.0, description="Turns of the servo for one of the joint."
    )
    shadows: tuple[ShadowConfig, ...] = Field(
        default=(), max_length=4, description="Further servos on the same joint."
    )
    mode: PositionMode = Field(
        default="position",
        description="Operating mode for positions: extended_position for more than a turn, "
        "current_based_position to limit the current as well.",
    )
    reverse: bool = Field(
        default=False,
        description="The servo counts the other way (Drive Mode, bit 0): written when it differs. "
        "Prefer `sign`, which leaves the servo as it is.",
    )
    torque_constant: float | None = Field(
        default=None,
        gt=0.0,
        le=100.0,
        description="Torque for one ampere, in N·m/A; from the stall figures of its model if null.",
    )
    current_limit: float | None = Field(
        default=None,
        gt=0.0,
        le=60.0,
        description="Most current that it is asked for, in A; what its register allows if null.",
    )
    pwm_limit: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="Most voltage that it is asked for, as part of the supply; what its register allows if "
        "null. Of AX, RX, MX(1.0) and XL-320 the Torque Limit.",
    )
    pwm_effort: bool = Field(
        default=False,
        description="Take efforts through PWM, by the stall torque and no-load speed of the model: "
        "estimates, for XL430, XC430, 2X and MX-28, which control no current.",
    )
    profile_velocity: float = Field(
        default=0.0,
        ge=0.0,
        le=100.0,
        description="The servo's own profile towards each position, in rad/s of the joint; 0: none. Of AX, "
        "RX, MX(1.0) and XL-320 the Moving Speed.",
    )
    profile_acceleration: float = Field(
        default=0.0, ge=0.0, le=12_000.0, description="The same, in rad/s² of the joint; 0: none."
    )
    gains: GainsConfig = Field(default=GainsConfig(), description="Control gains.")

    @field_validator("model")
    @classmethod
    def _known(cls, name: str) -> str:
        return model_named(name).name

    @property
    def servo_model(self) -> Model:
        """Model of the first servo."""
        return model_named(self.model)

    @property
    def operating_mode(self) -> OperatingMode:
        """Operating mode for positions."""
        return OPERATING_MODES[self.mode]

    @property
    def yields(self) -> bool:
        """Whether it gives way to what is in its way: by a limited current."""
        return self.mode == "current_based_position" and self.current_limit is not None

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of all servos, the first one first."""
        return (self.id, *(shadow.id for shadow in self.shadows))

    @model_validator(mode="after")
    def _possible(self) -> ServoConfig:
        model = self.servo_model
        if self.operating_mode not in model.modes:
            modes = [name for name, mode in OPERATING_MODES.items() if mode in model.modes]
            raise ValueError(f"mode: {model.name} has no {self.mode}, but {', '.join(modes)}")
        if model.family.is_older:
            self._check_older(model)
        for key in ("torque_constant", "current_limit"):
            if getattr(self, key) is not None and not model.reports_current:
                raise ValueError(f"{key}: {model.name} measures no current, only a load")
        if self.pwm_effort:
            self._check_pwm_effort()
        if self.protocol is not None and model.family.protocol == 1 and self.protocol == 2:
            raise ValueError(f"protocol: {model.name} speaks protocol 1")
        if len(set(self.ids)) != len(self.ids):
            raise ValueError("shadows: two of its servos have the same id")
        for shadow in self.shadows:
            if shadow.model and model_named(shadow.model).family is not model.family:
                raise ValueError(
                    f"shadows: {shadow.model} and {model.name} count in different units"
                )
            self._check_shadow(shadow, model_named(shadow.model) if shadow.model else model)
            if shadow.follow == "secondary_id" and shadow.sign != self.sign:
                raise ValueError(
                    f"shadows: servo {shadow.id} takes the goals of servo {self.id}, so it must count as "
                    f"that does: set its sign to {self.sign}, and reverse to true where they face each "
                    "other"
                )
        return self

    def _check_older(self, model: Model) -> None:
        """Refuse what the registers of the older servos do not have: it would be left out, unnoticed."""
        for key, other in (
            ("gains", "set them with a tool of your own"),
            ("profile_acceleration", "leave it out"),
        ):
            if getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(f"{key}: {model.name} has no such registers here: {other}")
        if self.reverse and not model.has_drive_mode:
            raise ValueError(f"reverse: {model.name} has no Drive Mode: set sign to {-self.sign}")

    @staticmethod
    def _check_shadow(shadow: ShadowConfig, model: Model) -> None:
        place = f"shadows: servo {shadow.id}, a {model.name},"
        if shadow.reverse and not model.has_drive_mode:
            raise ValueError(f"{place} has no Drive Mode: leave reverse out, and change its sign")
        if shadow.follow == "secondary_id" and model.family.is_older:
            raise ValueError(f"{place} has no Secondary ID: set follow to goals")
        if shadow.follow == "cable" and not model.has_cable:
            raise ValueError(f"{place} has no synchronisation cable: set follow to goals")

    def _check_pwm_effort(self) -> None:
        for name in (self.model, *(shadow.model for shadow in self.shadows if shadow.model)):
            model = model_named(name)
            if model.reports_current:
                raise ValueError(f"pwm_effort: {name} takes efforts by its current: leave it out")
            if not model.takes_torque_by_pwm or self.protocol == 1:
                raise ValueError(f"pwm_effort: {name} has no PWM mode here")


class JointConfig(ServoConfig):
    """One joint."""

    lower: float | None = Field(
        default=None, description="Least position in rad; half a turn of the servo if null."
    )
    upper: float | None = Field(
        default=None, description="Greatest position in rad; half a turn of the servo if null."
    )
    velocity: float | None = Field(
        default=None,
        gt=0.0,
        le=100.0,
        description="Limit in rad/s; nine tenths of the model's no-load speed if null.",
    )
    acceleration: float = Field(default=10.0, gt=0.0, le=10_000.0, description="Limit in rad/s².")
    jerk: float | None = Field(
        default=None,
        gt=0.0,
        le=1e6,
        description="Limit in rad/s³; ten times the acceleration if null.",
    )
    effort: float | None = Field(
        default=None,
        ge=0.0,
        le=10_000.0,
        description="Limit in N·m; the stall torque of the model if null.",
    )

    following_error: float = Field(
        default=0.35,
        gt=0.0,
        le=100.0,
        description="FAULT when the joint is further than this from where it was sent, in rad.",
    )
    arrival: float = Field(
        default=0.1,
        gt=0.0,
        le=100.0,
        description="A move has reached its goal when the joint is nearer than this, in rad: as far as the "
        "arm sags under its load.",
    )

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest position, in rad."""
        family = self.servo_model.family
        half = 0.5 * (family.highest - family.lowest) * family.position_unit / self.gear
        lower = self.offset - half if self.lower is None else self.lower
        upper = self.offset + half if self.upper is None else self.upper
        return lower, upper

    @model_validator(mode="after")
    def _range(self) -> JointConfig:
        lower, upper = self.range
        if not lower < upper:
            raise ValueError(f"lower ({lower:g}) must be below upper ({upper:g})")
        model = self.servo_model
        turn = (model.family.highest - model.family.lowest) * model.family.position_unit
        if self.mode == "position" and (upper - lower) * self.gear > turn * (1.0 + 1e-9):
            raise ValueError(
                f"from {lower:g} to {upper:g} rad is more than the servo can turn in mode position; "
                "set mode to extended_position"
            )
        if self.arrival > self.following_error:
            raise ValueError("arrival: must not be above following_error")
        known = {"velocity": model.no_load_speed, "effort": model.stall_torque}
        for key, value in known.items():
            if getattr(self, key) is None and math.isnan(value):
                raise ValueError(f"{key}: give a limit, none is known for {model.name}")
        return self


class FingerConfig(Settings):
    """How the fingers move with the servo."""

    kind: Literal["slider_crank", "linear", "jaw"] = Field(
        default="jaw",
        description="Rods from the horn to fingers on a rail; racks or screws; or a jaw that turns with "
        "the servo.",
    )
    horn: float | None = Field(
        default=None, gt=0.0, le=1.0, description="slider_crank: servo axis to rod pin, in m."
    )
    rod: float | None = Field(
        default=None, gt=0.0, le=1.0, description="slider_crank: rod between its pins, in m."
    )
    travel: float | None = Field(
        default=None,
        ge=-1.0,
        le=1.0,
        description="linear: change of the opening for one radian of the servo, in m.",
    )
    gap: float = Field(
        default=0.0,
        ge=-1.0,
        le=1.0,
        description="slider_crank: distance between the carriers when the fingers touch, in m; linear: "
        "opening at angle 0, in m.",
    )

    @property
    def finger(self) -> Finger:
        """The kinematics."""
        if self.kind == "slider_crank":
            return SliderCrank(self.horn or 0.0, self.rod or 0.0, self.gap)
        return Linear(self.travel or 0.0, self.gap) if self.kind == "linear" else Jaw()

    @model_validator(mode="after")
    def _complete(self) -> FingerConfig:
        needed = {"slider_crank": ("horn", "rod"), "linear": ("travel",), "jaw": ()}[self.kind]
        for key in ("horn", "rod", "travel"):
            if (getattr(self, key) is None) is (key in needed):
                raise ValueError(
                    f"{key}: is {'needed' if key in needed else 'not'} for {self.kind}"
                )
        if self.kind == "jaw" and self.gap:
            raise ValueError("gap: is not for jaw")
        _ = self.finger
        return self


class GripperConfig(BehindConfig, ServoConfig):
    """The gripper behind the arm: one joint, whose position is the opening."""

    joint: str = Field(
        default="gripper", min_length=1, max_length=64, description="Name of its joint."
    )
    finger: FingerConfig = Field(default=FingerConfig(), description="Kinematics of the fingers.")
    closed: float = Field(description="Least opening, in m; for a jaw in rad.")
    open: float = Field(description="Greatest opening, in m; for a jaw in rad.")
    velocity: float = Field(
        gt=0.0, le=100.0, description="Limit of the opening's velocity, in m/s; for a jaw in rad/s."
    )
    acceleration: float | None = Field(
        default=None,
        gt=0.0,
        le=1e5,
        description="Limit in m/s²; for a jaw in rad/s². The velocity in a tenth of a second if null.",
    )
    effort: float = Field(
        default=0.0,
        ge=0.0,
        le=10_000.0,
        description="Limit of the grasping force, in N; for a jaw in N·m. 0: no efforts are taken.",
    )

    @model_validator(mode="after")
    def _fingers(self) -> GripperConfig:
        if not self.closed < self.open:
            raise ValueError(f"closed ({self.closed:g}) must be below open ({self.open:g})")
        finger = self.finger.finger
        ends = [finger.angle(opening) for opening in (self.closed, self.open)]
        family = self.servo_model.family
        turn = (family.highest - family.lowest) * family.position_unit
        if self.mode == "position" and abs(ends[1] - ends[0]) * self.gear > turn:
            raise ValueError(
                "the servo would need more than its turn: set mode to extended_position"
            )
        return self


class DynamixelConfig(DeviceConfig):
    """A chain of DYNAMIXEL servos: an arm, a gripper, or both."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Arm": ("arm", "calibration", "turns", "disable", "on_close", "on_servo_fault"),
        "Bus": (
            "port",
            "baud",
            "rate",
            "latency_budget",
            "watchdog",
            "silent_timeout",
            "slow_interval",
            "fast_read",
            "return_delay",
            "status_return_level",
            "write_eeprom",
        ),
    }

    arm: str = Field(
        default="",
        max_length=4096,
        description="An arm of this package (koch_leader, koch_follower, open_manipulator_x, vx300s, arm6) "
        "or a file, whose keys hold where this configuration has none.",
    )
    port: PortName = Field(
        default="",
        max_length=250,
        description="Serial port of a chain with one bus: buses.main.port.",
    )
    baud: int | None = Field(
        default=None,
        ge=9600,
        le=10_500_000,
        description="Bit/s of a chain with one bus: buses.main.baud.",
    )
    buses: dict[str, BusConfig] = Field(
        default={MAIN_BUS: BusConfig()},
        min_length=1,
        max_length=16,
        description="Serial lines by name; each has port and baud.",
    )
    joints: dict[str, JointConfig] = Field(
        default={},
        max_length=64,
        description="Joints by name, in the order of joint vectors.",
    )
    gripper: GripperConfig | None = Field(default=None, description="The gripper; none if null.")
    calibration: str = Field(
        default="",
        max_length=4096,
        description="File of the calibration, written by crtk-driver dynamixel calibrate; none if empty.",
    )
    turns: str = Field(
        default="",
        max_length=4096,
        description="File that keeps where joints of more than one turn are while the power is off; none if "
        "empty.",
    )
    rate: float = Field(
        default=200.0, ge=1.0, le=2000.0, description="Cycles of reading and writing, in Hz."
    )
    latency_budget: float = Field(
        default=0.004,
        ge=0.0,
        le=0.5,
        description="Time that adapter and operating system may add to that of the wire, in s.",
    )
    watchdog: float = Field(
        default=0.1,
        ge=0.0,
        le=2.54,
        description="A servo stops by itself when it heard nothing for this long, in s (steps of 20 ms); "
        "0: never. Two cycles at least.",
    )
    silent_timeout: float = Field(
        default=0.25,
        gt=0.0,
        le=10.0,
        description="FAULT when a servo did not answer for this long, in s; below sample_timeout.",
    )
    slow_interval: float = Field(
        default=0.1,
        ge=0.01,
        le=60.0,
        description="Time between two readings of hardware error, voltage and temperature, in s.",
    )
    fast_read: bool = Field(
        default=True, description="Use fast sync and fast bulk read where the firmware has it."
    )
    return_delay: float | None = Field(
        default=0.0,
        ge=0.0,
        le=508e-6,
        description="Return Delay Time (9) of every servo, in s; null leaves it. Factory: 500e-6.",
    )
    status_return_level: Literal[1, 2] | None = Field(
        default=1,
        description="Status Return Level (68): 1 saves the answers to writes; null leaves it.",
    )
    write_eeprom: bool = Field(
        default=True,
        description="Write EEPROM registers that differ from this configuration; if false, refuse to enable.",
    )
    disable: Literal["torque_off", "hold"] = Field(
        default="torque_off",
        description="What disable does: let go of the arm, which may then fall, or keep the torque on.",
    )
    on_close: Literal["hold", "power_off"] = Field(
        default="hold",
        description="How servos that were enabled are left when the driver ends: holding where they "
        "stand, or without torque, so that an arm without brakes falls.",
    )
    on_servo_fault: Literal["hold", "torque_off"] = Field(
        default="hold",
        description="What the other servos do when one has a hardware error or is silent.",
    )

    @model_validator(mode="before")
    @classmethod
    def _with_arm(cls, values: Any) -> Any:
        if not isinstance(values, dict) or not values.get("arm"):
            return values
        return arms.beneath(values, str(values["arm"]))

    @model_validator(mode="after")
    def _chain(self) -> DynamixelConfig:
        if (self.port or self.baud is not None) and set(self.buses) != {MAIN_BUS}:
            raise ValueError(f"port and baud are for a chain whose only bus is {MAIN_BUS!r}")
        if self.port and self.buses[MAIN_BUS].port not in ("", self.port):
            raise ValueError("port: give port or buses.main.port, not both")
        taken: dict[tuple[str, int], str] = {}
        for place, servo in self.servos():
            if servo.bus not in self.buses:
                raise ValueError(
                    f"{place}.bus: there is no bus {servo.bus!r}, but {', '.join(self.buses)}"
                )
            for number in servo.ids:
                other = taken.setdefault((servo.bus, number), place)
                if other != place:
                    raise ValueError(
                        f"{place}: id {number} on bus {servo.bus} is also that of {other}"
                    )
        if not all(self.joints):
            raise ValueError("joints: a joint has no name")
        if self.gripper is not None and self.gripper.joint in self.joints:
            raise ValueError(
                f"joints.{self.gripper.joint}: is also the name of the gripper's joint"
            )
        return self

    @model_validator(mode="after")
    def _timings(self) -> DynamixelConfig:
        cycle, patience = 1.0 / self.rate, self.latency_budget
        silent, longest = 2.0 * cycle, 2.0 * max(cycle, patience)
        needed = (
            (
                "silent_timeout",
                self.silent_timeout < self.sample_timeout,
                f"below sample_timeout ({self.sample_timeout:g} s): the whole link would be given up before "
                "the servo that is silent is named",
            ),
            (
                "silent_timeout",
                self.silent_timeout >= silent,
                f"{silent:g} s at least, two cycles at a rate of {self.rate:g} Hz: a single answer that is "
                "lost would be a FAULT",
            ),
            (
                "silent_timeout",
                self.silent_timeout > MOST_GAPS * patience,
                f"above {MOST_GAPS * patience:g} s: a cycle waits up to {MOST_GAPS} times latency_budget "
                f"({patience:g} s) for servos that are silent",
            ),
            (
                "watchdog",
                not self.watchdog or self.watchdog >= longest,
                f"0 or {longest:g} s at least: at a rate of {self.rate:g} Hz and with a latency_budget of "
                f"{patience:g} s servos that nothing is wrong with would stop by themselves",
            ),
        )
        for key, is_met, text in needed:
            if not is_met:
                raise ValueError(f"{key} ({getattr(self, key):g} s) must be {text}")
        return self

    def servos(self) -> Iterator[tuple[str, ServoConfig]]:
        """Yield where each joint, then the gripper, is configured, and its table."""
        for name, joint in self.joints.items():
            yield f"joints.{name}", joint
        if self.gripper is not None:
            yield "gripper", self.gripper

    def bus(self, name: str) -> BusConfig:
        """Return a bus, with `port` and `baud` taken into account."""
        given = self.buses[name]
        baud = given.baud if self.baud is None else self.baud
        return BusConfig(port=self.port or given.port, baud=baud)
