"""Parameters of procedural walking styles: eight for pretraining, and a ninth that is held out."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class SyntheticStyle:
    """Parameters of one style of walking, symmetric between left and right.

    Angles are in degrees, lengths in metres, times in seconds. `_swing` is the amplitude of a motion with one period
    per cycle, `_bob` of one with two periods per cycle. The defaults describe an ordinary walk.

    Attributes:
        name: of the style.
        speed: natural speed, m/s.
        cadence: cycles per second at the natural speed.
        duty: share of the cycle that a foot is on the ground, in (0.5, 0.8).
        step_width: distance between the lines of left and right steps.
        toe_out: yaw of the planted foot, outward.
        swing_height: maximum height of the swinging foot.
        circumduction: how far the swinging foot arcs outward.
        strike: pitch of the foot at contact, toes up.
        push_off: pitch of the foot when the toes leave the ground.
        heel_off: share of the stance after which the heel rises.
        knee_out: how far the knees point outward of the feet.
        crouch: how far the hips stay below standing height.
        hip_bob: vertical amplitude of the hips.
        bob_delay: delay of that motion in degrees of phase.
        sway: sideways amplitude of the hips, towards the planted foot.
        hip_roll: amplitude by which the hip of the swinging leg drops.
        hip_yaw: amplitude by which the hip of the leading leg comes forward.
        lean: forward pitch of the trunk.
        lean_bob: amplitude of the lean.
        pelvis_pitch: forward pitch of the pelvis.
        twist: amplitude of the rotation of the shoulders against the hips.
        trunk_roll: amplitude of the trunk leaning over the planted foot.
        head_pitch: pitch of the head in the world, downward.
        head_bob, head_roll: amplitudes of nodding and tilting.
        arm_raise: forward angle of the upper arm.
        arm_swing: amplitude of that angle.
        arm_lag: delay of the arms relative to the legs in degrees of phase.
        arm_out: angle of the upper arm away from the body.
        arm_in: rotation of the arm about its own axis, which brings the hands in front of the body.
        elbow: bend of the elbow.
        elbow_swing: amplitude of the bend, greatest in front.
        shrug, hunch: upward and forward angle of the shoulders.
        wrist: droop of the hands.
        bank: lean into a turn, as a multiple of the angle of balance.
        look: time by which the head looks ahead into a turn.
    """

    name: str
    speed: float = 1.25
    cadence: float = 0.97
    duty: float = 0.61
    step_width: float = 0.16
    toe_out: float = 7.0
    swing_height: float = 0.07
    circumduction: float = 0.01
    strike: float = 16.0
    push_off: float = 38.0
    heel_off: float = 0.58
    knee_out: float = 3.0
    crouch: float = 0.03
    hip_bob: float = 0.016
    bob_delay: float = 18.0
    sway: float = 0.022
    hip_roll: float = 4.0
    hip_yaw: float = 6.0
    lean: float = 3.0
    lean_bob: float = 1.0
    pelvis_pitch: float = 3.0
    twist: float = 6.0
    trunk_roll: float = 1.0
    head_pitch: float = 4.0
    head_bob: float = 1.0
    head_roll: float = 0.5
    arm_raise: float = 2.0
    arm_swing: float = 22.0
    arm_lag: float = 12.0
    arm_out: float = 9.0
    arm_in: float = 12.0
    elbow: float = 22.0
    elbow_swing: float = 9.0
    shrug: float = 0.0
    hunch: float = 3.0
    wrist: float = 0.0
    bank: float = 0.8
    look: float = 0.25

    def __post_init__(self):
        if not 0.5 < self.duty < 0.8:
            raise ValueError(f"SyntheticStyle.duty must lie between 0.5 and 0.8, got {self.duty}.")
        if not 0.3 <= self.heel_off < 1.0:
            raise ValueError(f"SyntheticStyle.heel_off must lie in [0.3, 1), got {self.heel_off}.")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("speed", "cadence", "step_width", "swing_height") and value <= 0:
                raise ValueError(f"SyntheticStyle.{field.name} must be positive, got {value}.")


_PRETRAINING = (
    SyntheticStyle("neutral"),
    SyntheticStyle(
        "proud", speed=1.3, cadence=0.88, strike=20, lean=-7, pelvis_pitch=-2, head_pitch=-9, arm_raise=-9,
        arm_swing=27, arm_out=16, elbow=16, shrug=4, hunch=-14, twist=8, toe_out=11, hip_bob=0.02, swing_height=0.08,
    ),
    SyntheticStyle(
        "old", speed=0.7, cadence=0.84, duty=0.68, step_width=0.21, toe_out=15, swing_height=0.04, strike=5,
        push_off=17, heel_off=0.72, knee_out=10, crouch=0.075, hip_bob=0.007, sway=0.035, hip_roll=2, hip_yaw=3,
        lean=26, pelvis_pitch=12, twist=3, trunk_roll=3, head_pitch=12, arm_raise=16, arm_swing=7, arm_out=15,
        arm_in=38, elbow=62, elbow_swing=4, hunch=14, shrug=5, bank=0.4, look=0.15,
    ),
    SyntheticStyle(
        "angry", speed=1.55, cadence=1.14, duty=0.58, step_width=0.2, swing_height=0.09, strike=11, push_off=42,
        crouch=0.045, hip_bob=0.026, bob_delay=8, lean=15, lean_bob=3, pelvis_pitch=6, twist=12, head_pitch=13,
        head_bob=3, arm_raise=4, arm_swing=30, arm_lag=4, arm_out=21, arm_in=25, elbow=58, elbow_swing=14,
        shrug=9, hunch=12,
    ),
    SyntheticStyle(
        "depressed", speed=0.85, cadence=0.74, duty=0.66, step_width=0.14, swing_height=0.045, strike=8, push_off=27,
        heel_off=0.66, crouch=0.045, hip_bob=0.009, sway=0.03, hip_roll=5, hip_yaw=4, lean=14, pelvis_pitch=-4, twist=3,
        head_pitch=42, head_roll=3, arm_raise=9, arm_swing=6, arm_lag=35, arm_out=5, arm_in=22, elbow=9, elbow_swing=2,
        shrug=-5, hunch=17, bank=0.5, look=0.1,
    ),
    SyntheticStyle(
        "childlike", speed=1.3, cadence=1.24, duty=0.57, step_width=0.15, toe_out=2, swing_height=0.13, strike=12,
        push_off=52, crouch=0.02, hip_bob=0.042, bob_delay=30, sway=0.03, hip_roll=6, hip_yaw=10, lean=2, lean_bob=3,
        twist=11, trunk_roll=5, head_pitch=-5, head_bob=4, head_roll=7, arm_raise=12, arm_swing=42, arm_lag=18,
        arm_out=27, elbow=34, elbow_swing=22, shrug=5, look=0.4,
    ),
    SyntheticStyle(
        "strutting", speed=1.1, cadence=0.79, duty=0.62, step_width=0.07, toe_out=9, swing_height=0.09,
        circumduction=0.05, strike=17, push_off=44, knee_out=7, crouch=0.035, hip_bob=0.022, bob_delay=-6, sway=0.055,
        hip_roll=10, hip_yaw=13, lean=-9, lean_bob=3, twist=19, trunk_roll=6, head_pitch=-4, head_bob=4, head_roll=4,
        arm_raise=-3, arm_swing=31, arm_lag=32, arm_out=25, arm_in=30, elbow=42, elbow_swing=15, shrug=6, hunch=-6,
    ),
    SyntheticStyle(
        "sneaking", speed=0.75, cadence=0.66, duty=0.65, step_width=0.13, swing_height=0.15, strike=-6, push_off=46,
        heel_off=0.52, knee_out=8, crouch=0.17, hip_bob=0.018, bob_delay=50, sway=0.045, hip_roll=3, hip_yaw=9, lean=25,
        lean_bob=4, pelvis_pitch=10, twist=7, head_pitch=-3, head_bob=3, arm_raise=44, arm_swing=13, arm_lag=25,
        arm_out=24, arm_in=10, elbow=84, elbow_swing=12, shrug=10, hunch=10, wrist=22, look=0.35,
    ),
)  # fmt: skip

_UNSEEN = SyntheticStyle(
    "zombie", speed=0.8, cadence=0.7, duty=0.66, step_width=0.25, toe_out=10, swing_height=0.05, circumduction=0.05,
    strike=3, push_off=22, heel_off=0.68, knee_out=4, crouch=0.055, hip_bob=0.012, bob_delay=-15, sway=0.06, hip_roll=6,
    hip_yaw=11, lean=18, lean_bob=2, pelvis_pitch=8, twist=9, trunk_roll=9, head_pitch=6, head_roll=8, arm_raise=102,
    arm_swing=7, arm_lag=60, arm_out=14, arm_in=-4, elbow=16, elbow_swing=5, shrug=8, hunch=16, wrist=38, bank=0.4,
    look=0.1,
)  # fmt: skip

STYLES: dict[str, SyntheticStyle] = {style.name: style for style in (*_PRETRAINING, _UNSEEN)}
"""All nine styles by name, in the order of pretraining; the last one is held out."""
PRETRAINING_STYLES: tuple[str, ...] = tuple(style.name for style in _PRETRAINING)
"""Names of the eight styles on which a shared network is pretrained."""
UNSEEN_STYLE: str = _UNSEEN.name
"""Name of the ninth style: raised arms, wide steps and a rolling trunk lie outside the span of the other eight."""
