"""Command tracking: makes the character reach the commanded speed and heading, and stop.

- Time scaling: frames are drawn faster or slower than the network predicts them, so that root, feet and phase change
  speed together. After a command to stop the network goes on unseen until its feet pass each other, and waits there.
- Heading correction: the character is rotated as one rigid body towards the commanded heading, about the foot on which
  it stands.
- The future trajectory that the network reads is limited to the speed that its style allows.
"""

import numpy as np

from .ground import angle, mix, turn_towards


def wrap(turn):
    """Returns an angle in [-pi, pi)."""
    return (turn + np.pi) % (2 * np.pi) - np.pi


class Tracking:
    """The state of command tracking for one character.

    Attributes:
        time_scale: seconds of network time per second of real time; 0 while the network waits.
        velocity: complex, m/s of network time relative to the root: a running mean over about one step.
        heading_error: radians from the actual to the commanded heading: a running mean.
        strafe_failure: seconds by which failing to strafe outweighs succeeding.
        min_distance: metres, recent minimum of the distance between the feet.
        waiting: whether the network waits for the next walk.
    """

    def __init__(self, constants, speed, gain, distance):
        self.constants, self.speed, self.gain = constants, speed, gain
        self.time_scale, self.velocity, self.heading_error = 0.0, complex(speed), 0.0
        self.strafe_failure, self.min_distance, self.waiting = 0.0, distance, True

    def moving(self, velocity):
        """Returns whether a commanded velocity means to move, not to stop."""
        return abs(velocity) > self.constants["stop_speed"]

    def update_time_scale(self, velocity):
        """Sets the time scale of the next drawn frame."""
        k, moving = self.constants, self.moving(velocity)
        self.waiting = self.waiting and not moving
        target = max(self.time_scale, k["stopping_time_scale"])
        if moving:
            reachable = abs(velocity) / max(abs(self.velocity), k["min_walk_speed"])
            target = np.clip(reachable, k["min_time_scale"], k["max_time_scale"])
        self.time_scale = 0.0 if self.waiting else mix(self.time_scale, target, k["time_scale_rate"])

    def network_command(self, velocity, direction, facing):
        """Returns the velocity and the facing to command to the network, near what its style has been trained on."""
        k, wanted = self.constants, abs(velocity)
        lower, upper = (1.0 + sign * k["speed_tolerance"] for sign in (-1, 1))
        requested = np.clip(wanted, lower * self.speed, upper * self.speed) * self.gain
        held = np.clip(2.0 - self.strafe_failure / k["strafe_timeout"], 0.0, 1.0)  # the facing, unless strafing fails
        turn_left = angle(facing, turn_towards(velocity / wanted, direction, held))
        turn_now = np.clip(turn_left, -k["max_requested_turn"], k["max_requested_turn"])
        velocity = velocity * requested / wanted * np.exp(1j * (turn_now - turn_left))
        return velocity, facing * np.exp(1j * turn_now)

    def update(self, step, facing, velocity, direction, distance, stands):
        """Updates the state after a network frame.

        Args:
            step: complex, metres that the root has moved.
            facing: of the root before.
            velocity, direction: the command.
            distance: metres between the feet.
            stands: whether nothing of the network's motion is drawn, so that it may wait.
        """
        k, moving = self.constants, self.moving(velocity)
        self.velocity = mix(self.velocity, step * k["fps"] / facing, k["velocity_rate"])
        error = angle(facing * self.velocity, velocity) if moving else 0.0
        self.heading_error = wrap(self.heading_error + k["heading_rate"] * wrap(error - self.heading_error))
        self._update_strafing(velocity, direction)
        self.min_distance = min(distance, self.min_distance + k["distance_rise"] / k["fps"])
        passing = distance <= self.min_distance + k["passing_tolerance"]
        self.waiting = not moving and (self.waiting or (passing and stands))

    def _update_strafing(self, velocity, direction):
        k = self.constants
        if not self.moving(velocity) or abs(angle(velocity, direction)) <= k["heading_tolerance"]:
            self.strafe_failure = 0.0
            return
        recovery = -1.0 if self.strafe_failure < k["strafe_timeout"] else 0.0  # once released, the facing stays so
        failing = abs(self.heading_error) > k["heading_tolerance"]
        self.strafe_failure = max(self.strafe_failure + (1.0 if failing else recovery) / k["fps"], 0.0)

    def heading_correction(self, velocity):
        """Returns the angle in radians by which the character is rotated in one network frame."""
        if not self.moving(velocity):
            return 0.0
        k = self.constants
        rate = np.clip(k["correction_gain"] * self.heading_error, -k["max_correction_rate"], k["max_correction_rate"])
        return rate / (k["fps"] * max(self.time_scale, k["min_time_scale"]))
