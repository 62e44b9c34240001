"""Standing: the body brings both feet to the floor, turns on the spot, and walks off again.

A network is trained on walking. Between the command to stop and the next walk the drawn body therefore leaves the
network's motion for the stance of its style: it comes to rest where a walking body can (the capture point), its feet
land there one after the other, and it sways. The network goes on unseen and waits with its feet passing each other.

Points on the ground are complex; feet are [2, 2, 3] metres, heel and toe of the left and the right foot.
"""

import numpy as np

from .ground import angle, mix


def ground(points):
    """Returns points [..., 3] on the ground, as complex numbers [...]."""
    return points[..., 2] + 1j * points[..., 0]


def at_height(points, heights):
    """Returns points [..., 3] of complex numbers [...] on the ground and heights [...]."""
    return np.stack(np.broadcast_arrays(points.imag, heights, points.real), -1)


def middle(feet):
    """Returns the middles [2] of feet on the ground."""
    return ground(feet.mean(1))


def smooth(share):
    """Returns the smoothstep of a share in [0, 1]."""
    return share * share * (3.0 - 2.0 * share)


def direction_of(v):
    """Returns complex numbers at length 1; those without a direction become 1."""
    size = np.abs(v)
    return np.where(size > 1e-6, v / np.maximum(size, 1e-6), 1.0)


class Standing:
    """The state of standing of one character.

    Attributes:
        weight: 0 walks as the network does, 1 stands.
        stopped: whether the last command was to stop.
        facing, turn_rate: of the drawn body, and radians per second.
        centre, hips, velocity: complex, of the stance, of the hips, and metres per second.
        feet: of the drawn body.
        lifted, launch, land, elapsed, duration, stepping: of each foot's step: from where, with which velocity, to
            where, for how many seconds, of how many, and whether it is in the air.
        hips_offset, feet_offset: from the network's to the drawn body when it walked off.
    """

    def __init__(self, constants, stance, leg_length, speed, centre, facing):
        self.constants, self.leg_length, self.speed = constants, leg_length, speed
        self.height, self.stance_hips = stance["height"], complex(stance["hips"][1], stance["hips"][0])
        self.rotations, self.stance_feet = np.array(stance["rotations"]), np.array(stance["feet"])
        self.floor, self.chest = self.stance_feet[..., 1], np.array(stance["chest"])
        self.weight, self.stopped, self.seconds = 1.0, True, 0.0
        self.facing, self.turn_rate, self.centre = facing, 0.0, centre
        self.hips, self.velocity = centre + self.stance_hips * facing, 0j
        self.feet = self.lifted = self.land = self._places(centre, facing)
        self.launch, self.elapsed, self.duration = 0.0 * self.feet, np.ones(2), np.ones(2)
        self.stepping = np.zeros(2, bool)
        self.hips_offset, self.feet_offset = 0j, 0.0 * self.feet

    def update(self, walk, moving, direction):
        """Advances one drawn frame.

        Args:
            walk: hips and facing (complex), feet and contacts [2, 2] of the body as the network has it.
            moving: whether the command is to walk.
            direction: commanded facing.
        """
        k = self.constants
        seconds = -k["start_seconds"] if moving else k["stop_seconds"]
        weight = self.weight + 1.0 / (k["fps"] * seconds)
        self.weight = min(max(round(weight, 9), 0.0), 1.0)  # exactly 0 or 1 after so many frames, whatever the rounding
        if moving:
            if self.stopped:
                self.hips_offset, self.feet_offset = self.hips - walk["hips"], self.feet - walk["feet"]
            self.stopped = False
            self._follow(walk)
            return
        if not self.stopped:
            before = self.facing, self.hips, self.feet
            self._follow(walk)
            self._begin_stop(walk, *before)
        self._stand(direction)

    def _follow(self, walk):
        """Takes up the motion of the network, and what is left of the offsets."""
        share, fps = smooth(self.weight), self.constants["fps"]
        hips, self.feet = walk["hips"] + share * self.hips_offset, walk["feet"] + share * self.feet_offset
        self.turn_rate, self.velocity = angle(self.facing, walk["facing"]) * fps, (hips - self.hips) * fps
        self.facing, self.hips, self.seconds = walk["facing"], hips, 0.0

    def _begin_stop(self, walk, facing, hips, feet):
        """Decides where the body will stand, and what its feet do first; the rest is as it was a frame before."""
        k, above = self.constants, self.feet[..., 1] - self.floor
        down = (walk["contacts"].max(1) >= 0.5) & (above.min(1) < k["down_height"] * self.leg_length)
        flat, launch = self._flat(above), (self.feet - feet) * k["fps"]
        centre = self._rest_place(flat, down, launch)
        land = np.where(down[:, None, None], flat, self._places(centre, self.facing))
        distance, speed = abs(middle(land - self.feet)), abs(middle(launch))
        shortest, longest = k["step_seconds"]
        airborne = np.clip(2.5 * distance / np.maximum(speed, 1e-3), 0.75 * shortest, longest)
        self.stopped, self.centre, self.launch, self.land = True, centre, launch, land
        self.elapsed, self.duration = np.zeros(2), np.where(down, k["settle_seconds"], airborne)
        self.stepping = ~down
        self.facing, self.hips, self.feet, self.lifted = facing, hips, feet, feet

    def _flat(self, above):
        """Returns the feet put flat on the floor around the lower of heel and toe, whose heights are above [2, 2]."""
        heel, toe = ground(self.feet).T
        along = abs(np.diff(ground(self.stance_feet))[:, 0]) * direction_of(toe - heel)
        heel = np.where(above[:, 1] < above[:, 0], toe - along, heel)
        return at_height(np.stack([heel, heel + along], 1), self.floor)

    def _rest_place(self, flat, down, launch):
        """Returns the centre of the stance in which a walking body comes to rest."""
        k, ahead = self.constants, self.velocity / self.constants["rest_rate"]
        capture = self.hips + ahead - self.stance_hips * self.facing
        middles = middle(self.stance_feet) * self.facing
        apart = middle(flat) - middles - capture
        distance = np.where(down, abs(apart), np.inf)
        if distance.min() < k["keep_distance"] * self.leg_length:
            return capture + apart[np.argmin(distance)]
        flying = (middle(self.feet + 0.12 * launch) - middles - capture) * np.conj(direction_of(ahead))
        return capture + np.clip(np.where(down, 0.0, flying.real).max(), 0.0, abs(ahead)) * direction_of(ahead)

    def _stand(self, direction):
        """Turns the body, lets its hips settle, and makes its feet step."""
        k, dt = self.constants, 1.0 / self.constants["fps"]
        self.seconds += dt
        most, wanted = k["max_turn_acceleration"] * dt, 0.0
        left = angle(self.facing, direction)
        late = self.seconds > k["turn_delay"] + 1e-4  # a sum of frames, which rounding must not make a frame shorter
        if late or abs(left) < k["straighten"]:
            wanted = np.clip(k["turn_gain"] * left, -k["max_turn_rate"], k["max_turn_rate"])
        self.turn_rate += np.clip(wanted - self.turn_rate, -most, most)
        self.facing = self.facing * np.exp(1j * self.turn_rate * dt)
        rate, goal = k["rest_rate"], self.centre + self.stance_hips * self.facing
        push, fade = self.velocity + rate * (self.hips - goal), np.exp(-rate * dt)
        self.hips = goal + (self.hips - goal + push * dt) * fade
        self.velocity = (self.velocity - push * rate * dt) * fade
        self._step_feet()

    def _step_feet(self):
        """Moves the feet: one that is too far from its place in the stance steps there."""
        k, (shortest, longest) = self.constants, self.constants["step_seconds"]
        places = self._places(self.centre, self.facing * np.exp(1j * self.turn_rate * longest))
        distance = abs(middle(places - self.land))
        off = abs(angle(*(np.diff(ground(points))[:, 0] for points in (self.land, places))))
        turning = abs(self.turn_rate) / k["max_turn_rate"]
        tolerance = k["step_angle"] + turning * k["turning_angle"]
        need = distance / (k["step_distance"] * self.leg_length) + off / tolerance
        inside = 0.1 * np.sign(self.turn_rate) * np.array([1.0, -1.0])  # of two alike, the inner foot steps first
        need = np.where(need > 1.0, need + inside, 0.0)
        lifts = (need > 0.0) & (need >= need[::-1]) & ~self.stepping.any()
        lifts[1] &= not lifts[0]
        self.elapsed = np.where(lifts, 0.0, self.elapsed) + 1.0 / k["fps"]
        fast = max(k["step_speed"] * self.speed, 1e-3)
        self.duration = np.where(lifts, np.clip(distance / fast, shortest, longest), self.duration)
        begins = lifts[:, None, None]
        self.lifted, self.launch = np.where(begins, self.feet, self.lifted), np.where(begins, 0.0, self.launch)
        self.stepping = self.stepping | lifts
        self.land = np.where(self.stepping[:, None, None], places, self.land)
        share = np.clip(self.elapsed / self.duration, 0.0, 1.0)
        self.feet = self._swing(share)
        self.stepping = self.stepping & (share < 1.0)

    def _swing(self, share):
        """Returns feet on a cubic from where they began, with their velocity, to a place at rest, lifted in between."""
        s, run = share[:, None, None], self.duration[:, None, None]
        feet = mix(self.lifted, self.land, smooth(s)) + self.launch * run * s * (1.0 - s) ** 2
        part, least, most = np.array(self.constants["step_height"]) * [1.0, self.leg_length, self.leg_length]
        height = np.clip(part * abs(middle(self.land - self.lifted)), least, most)
        rise = (self.lifted[..., 1] - self.floor).min(1)  # a foot that is in the air already is not lifted again
        height = height * np.clip(1.0 - rise / least, 0.0, 1.0) * self.stepping * 16.0 * share**2 * (1.0 - share) ** 2
        feet[..., 1] = np.maximum(feet[..., 1] + height[:, None], self.floor)
        return feet

    def sway(self):
        """Returns the metres by which the hips shift to the left, and the pitch of the chest in radians."""
        k = self.constants
        time = max(self.seconds - k["turn_delay"], 0.0)
        share, turn = smooth(self.weight) * smooth(min(time, 1.0)), 2.0 * np.pi * time
        (shift_seconds, breath_seconds), (shift, breath) = k["sway_seconds"], k["sway"]
        shifted = 0.8 * np.sin(turn / shift_seconds) + 0.2 * np.sin(3.0 * turn / shift_seconds)
        return share * shift * self.leg_length * shifted, share * breath * np.sin(turn / breath_seconds)

    def contacts(self):
        """Returns the contacts [4] of the feet: 1 for a heel or toe on the floor."""
        above = self.feet[..., 1] - self.floor
        return np.clip(1.5 - above / self.constants["contact_height"], 0.0, 1.0).ravel()

    def _places(self, centre, facing):
        """Returns the feet of the stance in the world."""
        return at_height(ground(self.stance_feet) * facing + centre, self.floor)
