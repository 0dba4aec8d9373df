"""Defects that a virtual arm can have, for a bench that must find them: keys, defaults, units, bounds."""

from __future__ import annotations

from pydantic import Field

from crtk_drivers.config import Settings


class DefectsConfig(Settings):
    """What is wrong with the arm. Absent keys are no defect; all but the clock's are of its joints."""

    joints: tuple[int, ...] | None = Field(
        default=None,
        max_length=20,
        description="The joints that have the defects of joints, counted from 0; all if null.",
    )
    seed: int = Field(default=1, ge=0, description="Of all that is random.")

    # What is measured.
    position_noise: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Standard deviation of measured positions, in rad (m).",
    )
    position_line: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Amplitude of a line in measured positions, in rad (m).",
    )
    line_frequency: float = Field(
        default=50.0, gt=0.0, le=500.0, description="Of that line, in Hz."
    )
    position_drift: float = Field(
        default=0.0, ge=-1.0, le=1.0, description="Of measured positions, in rad/s (m/s)."
    )
    position_jump: float = Field(
        default=0.0,
        ge=-10.0,
        le=10.0,
        description="By which measured positions are off once a joint has passed `jump_at` upwards, in rad "
        "(m), as after the wrap of an encoder; the other way downwards. Over 0.25 that is FAULT: does not "
        "follow.",
    )
    jump_at: float = Field(
        default=0.0, ge=-10.0, le=10.0, description="Joint position of that jump, in rad (m)."
    )
    backlash: float = Field(
        default=0.0,
        ge=0.0,
        le=0.5,
        description="Between motor and joint, in rad (m): what is measured stays behind by half of it "
        "either way. Over 0.02 moves fail, as the joint does not arrive.",
    )
    velocity_lag: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Measured velocities are those of so long ago, in s. A stop is confirmed as much later.",
    )
    velocity_scale: float = Field(
        default=1.0, ge=-10.0, le=10.0, description="Factor on measured velocities."
    )
    effort_sign: int = Field(
        default=1, ge=-1, le=1, description="-1: measured efforts have the wrong sign."
    )
    effort_scale: float = Field(
        default=1.0, ge=0.0, le=10.0, description="Factor on measured efforts."
    )
    homing_noise: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Standard deviation of the zero that home finds, in rad (m).",
    )
    calibration: float = Field(
        default=0.0,
        ge=-1.0,
        le=1.0,
        description="Added to each joint where measured_cp is computed, and nowhere else, in rad (m): as "
        "of kinematics that are not those of the arm.",
    )
    pose_scale: float = Field(
        default=1.0,
        gt=0.0,
        le=1e4,
        description="Factor on the position in measured_cp; 1000: mm for m. A straight line, which begins "
        "there, may be refused.",
    )
    twist_scale: float = Field(default=1.0, ge=-10.0, le=10.0, description="Factor on measured_cv.")

    force_noise: float = Field(
        default=0.0,
        ge=0.0,
        le=1000.0,
        description="Standard deviation of each axis of measured_cf, in N and N·m.",
    )
    force_line: float = Field(
        default=0.0,
        ge=0.0,
        le=1000.0,
        description="Amplitude of a line in each axis of measured_cf, at `line_frequency`, in N and N·m.",
    )
    force_drift: float = Field(
        default=0.0,
        ge=-100.0,
        le=100.0,
        description="Of each axis of measured_cf, in N/s and N·m/s.",
    )
    force_scale: float = Field(
        default=1.0, ge=-10.0, le=10.0, description="Factor on measured_cf: a load weighs another."
    )

    # When it is measured, and with which stamp.
    frozen_share: float = Field(
        default=0.0,
        ge=0.0,
        lt=1.0,
        description="Share of the samples that have the values of the one before, and a new stamp.",
    )
    lost_samples: float = Field(
        default=0.0, ge=0.0, lt=1.0, description="Share of the cycles, at random, without a sample."
    )
    slow: float = Field(
        default=1.0,
        gt=0.0,
        le=1.0,
        description="Share of the declared rate at which samples come, evenly.",
    )
    jitter: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="Each read waits for the size of a normal random number of this standard deviation, in "
        "s, even past the deadline; cycles that come too late are left out, and counted.",
    )
    age: float = Field(
        default=0.0,
        ge=0.0,
        le=2.0,
        description="Samples are delivered so much later, in s. From five periods (at least 0.02) their "
        "stamps are 0 and nothing can be enabled; from `sample_timeout` the link counts as lost. "
        "`arrival_stamps` hides it from both.",
    )
    arrival_stamps: bool = Field(
        default=False, description="Stamps are those of the delivery, not of the acquisition."
    )
    stamp_jitter: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Standard deviation of stamps, in s."
    )
    clock_drift: float = Field(
        default=0.0,
        ge=-1e5,
        le=1e5,
        description="By which the clock of the stamps is too fast, in ppm. One that is too slow makes "
        "samples older and older, until they are as stale as with `age`.",
    )
    stale_stamps: bool = Field(
        default=False,
        description="When the link is lost, the last sample goes on being delivered, stamped anew.",
    )

    # What power does.
    sag_on_disable: float = Field(
        default=0.0,
        ge=0.0,
        le=0.5,
        description="By which a joint drops when power goes, the way that its weight pulls, in rad (m).",
    )
    jump_on_enable: float = Field(
        default=0.0,
        ge=-0.5,
        le=0.5,
        description="By which a joint moves when it is enabled, in rad (m).",
    )
    jump_on_reconnect: float = Field(
        default=0.0,
        ge=-0.5,
        le=0.5,
        description="By which a joint has moved when the driver is connected again, in rad (m).",
    )

    # How it moves.
    tracking_lag: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="By which joints follow later, in s. More than 0.25 rad (m) behind, or a move that has "
        "not arrived in time, is FAULT.",
    )
    gain: float = Field(
        default=1.0,
        gt=0.0,
        le=2.0,
        description="Factor on the way from where it was enabled. More than 0.01 rad (m) off, moves fail.",
    )
    following_offset: float = Field(
        default=0.0,
        ge=-0.2,
        le=0.2,
        description="By which joints rest beside their setpoint, in rad (m). Over 0.01 moves fail.",
    )
    repeatability: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="Standard deviation of where a joint comes to rest, in rad (m), drawn for each motion. "
        "Over 0.01 off, moves fail.",
    )
    resonance: float = Field(
        default=0.0,
        ge=0.0,
        le=50.0,
        description="Joints hang from their motors as from springs that swing at this frequency, in Hz.",
    )
    damping: float = Field(
        default=0.1, gt=0.0, le=1.0, description="Damping ratio of those springs."
    )
    hunting: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="Amplitude of a limit cycle of the servos while the brakes are open, in rad (m).",
    )
    hunting_frequency: float = Field(
        default=8.0, gt=0.0, le=50.0, description="Of that limit cycle, in Hz."
    )
    line_bow: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="By which the tool is beside its path while it moves (over 0.02 m/s), in m.",
    )
    speed_ripple: float = Field(
        default=0.0,
        ge=0.0,
        lt=1.0,
        description="Share by which speed goes up and down, 10 times a second.",
    )
    overspeed: float = Field(
        default=1.0,
        ge=1.0,
        le=2.0,
        description="Factor on the speed of a joint that was sent at its velocity limit, until it is 0.1 rad "
        "(m) ahead.",
    )
    overtravel: float = Field(
        default=0.0,
        ge=0.0,
        le=0.2,
        description="By which a joint that was sent to the end of its range passes it, in rad (m).",
    )
    coulomb_friction: float = Field(
        default=0.0,
        ge=0.0,
        le=50.0,
        description="In N·m (N) in each joint; the key `friction` changes the viscous one.",
    )
    slow_stop: float = Field(
        default=1.0,
        ge=1.0,
        le=1000.0,
        description="Times as long as usual that a joint brakes after a stop. From 2 s: FAULT, "
        "not carried out.",
    )
    rebound: float = Field(
        default=0.0,
        ge=0.0,
        le=0.2,
        description="By which a joint that was stopped in motion goes back once it stands, in rad (m).",
    )
    ignores_stop: bool = Field(
        default=False,
        description="A stop does nothing, and joints that were in motion (over 0.1 rad/s, m/s) go on with "
        "it: FAULT 2 s after hold, and more than 0.25 rad (m) past the end of a stream; they go on. "
        "`disable` closes the brakes after 2 s.",
    )
    ignores_watchdog: bool = Field(
        default=False,
        description="Joints in motion go on with it while the driver is frozen, for 5 s at most; otherwise "
        "the arm's time stands still.",
    )
