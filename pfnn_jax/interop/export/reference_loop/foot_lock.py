"""Foot locking: heels and toes are held where they touch the ground, and released without a jump.

A held joint keeps its place by an offset from the predicted motion; after its release the offset decays like a
critically damped spring. Heel and toe are one rigid piece: the one that is not held follows the other. The order is
left heel, left toe, right heel, right toe throughout.
"""

import numpy as np

PARTNER = [1, 0, 3, 2]


class FootLocks:
    """The locks of one character.

    Attributes:
        places: [4, 3] metres where each joint is held, or was held last.
        held: [4] bool.
        strength: [4] in [0, 1]: rises while a joint is held, and falls after its release.
        offsets, velocities: [4, 3] from the predicted to the corrected joint, in metres and metres per second.
        drop: metres by which the hips are lowered, and its velocity.
    """

    def __init__(self, constants, body, leg_length):
        self.constants, self.body, self.leg_length = constants, body, leg_length
        self.places, self.offsets, self.velocities = np.zeros((3, 4, 3))
        self.held, self.strength, self.drop = np.zeros(4, bool), np.zeros(4), (0.0, 0.0)

    def apply(self, hips, local, contacts):
        """Returns the hips [3] and the local rotations [J, 4] with the feet held, by contacts [4] in [0, 1]."""
        positions, world = self.body.forward_kinematics(hips, local)
        feet = positions[self.body.feet]
        self._update(feet, contacts)
        targets = feet + self.offsets
        targets[:, 1] = np.maximum(targets[:, 1], self.constants["floor"])
        needed = self._needed_drop(positions, targets)
        drop, speed = self._decay(self.drop[0] - needed, self.drop[1])
        self.drop = needed + drop, speed
        lowered = np.array([0.0, -self.drop[0], 0.0])
        local, share = local.copy(), self.strength**2 * (3.0 - 2.0 * self.strength)
        for side, leg in enumerate(self.body.legs):
            goal = targets[2 * side : 2 * side + 2]
            self.body.place_leg(leg, local, world, positions + lowered, goal, share[2 * side + 1])
        return hips + lowered, local

    def _update(self, feet, contacts):
        k, fps = self.constants, self.constants["fps"]
        limits = np.array([k["heel_limit"], k["toe_limit"]] * 2) * self.leg_length
        gap = self.places - feet
        rise = np.ones((4, 3))
        rise[::2, 1] = k["heel_rise"]  # heels leave the ground before toes, and must not be kept down
        near = ((gap * rise) ** 2).sum(-1) < limits**2
        kept = self.held & (contacts >= k["release_threshold"]) & near
        leads = kept[PARTNER][:, None]  # a joint that is not held follows its held partner
        goal, before, pull = (np.where(leads, v[PARTNER], 0.0) for v in (gap, self.offsets, self.velocities))
        away, away_velocity = self._decay(self.offsets - before, self.velocities - pull)
        free = goal + away
        close = (away**2).sum(-1) < (k["max_lock_offset"] * self.leg_length) ** 2
        starting = ~self.held & (contacts >= k["lock_threshold"]) & close
        offsets = np.where(kept[:, None], gap, free)
        moving = away_velocity + np.where(leads, (goal - before) * fps, 0.0)
        self.places = np.where(starting[:, None], feet + free, self.places)
        self.held = kept | starting
        change = np.where(self.held, 1.0 / k["lock_time"], -1.0 / k["release_time"]) / fps
        self.strength = np.clip(self.strength + change, 0.0, 1.0)
        self.velocities = np.where(kept[:, None], (offsets - self.offsets) * fps, moving)
        self.offsets = offsets

    def _decay(self, offset, velocity):
        """Advances a critically damped spring with rest position 0 by one frame."""
        dt, rate = 1.0 / self.constants["fps"], self.constants["decayed"] / self.constants["release_time"]
        push, fade = velocity + rate * offset, np.exp(-rate * dt)
        return (offset + push * dt) * fade, (velocity - push * rate * dt) * fade

    def _needed_drop(self, positions, targets):
        """Returns the metres by which the hips must sink for both heels to be within reach."""
        drops = []
        for side, (hip, knee, heel, _) in enumerate(self.body.legs):
            upper, lower, now = (
                np.linalg.norm(positions[a] - positions[b]) for a, b in ((knee, hip), (heel, knee), (heel, hip))
            )
            reach, to = max(0.995 * (upper + lower), now), targets[2 * side] - positions[hip]
            drops.append(-to[1] - np.sqrt(max(reach**2 - to[0] ** 2 - to[2] ** 2, 1e-6)))
        return np.clip(max(drops), 0.0, self.constants["max_drop"] * self.leg_length)
