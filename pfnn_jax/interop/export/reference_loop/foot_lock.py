"""Foot locking: heels and toes are held where they touch the ground, and released without a jump.

A held joint keeps its place on the ground by an offset from the predicted motion, and follows it down to the height at
which it rests; after its release the offset decays like a critically damped spring. Heel and toe are one rigid piece:
the one that is not held follows the other. The order is left heel, left toe, right heel, right toe throughout.
"""

import numpy as np

from .ground import to_world

PARTNER = [1, 0, 3, 2]


class FootLocks:
    """The locks of one character.

    Attributes:
        places: [4, 3] metres where each joint is held, or was held last.
        held: [4] bool.
        settling, sinking: [4] metres by which a held joint is above the height that it comes down to, and its velocity.
        strength: [4] in [0, 1]: rises while a joint is held, and falls after its release.
        offsets, velocities: [4, 3] from the predicted to the corrected joint, in metres and metres per second.
        drop: metres by which the hips are lowered, and its velocity.
    """

    def __init__(self, constants, body, leg_length):
        self.constants, self.body, self.leg_length = constants, body, leg_length
        self.places, self.offsets, self.velocities = np.zeros((3, 4, 3))
        self.held, self.drop = np.zeros(4, bool), (0.0, 0.0)
        self.settling, self.sinking, self.strength = np.zeros((3, 4))
        self.rest = np.full(4, constants["floor"])
        if body.resting_heights is not None:
            self.rest = np.maximum(np.ravel(body.resting_heights), self.rest)

    def plan(self, positions, contacts):
        """Returns where heels and toes [2, 2, 3] go, the shares [2] by which toes decide, and the drop of the hips.

        Args:
            positions: [J, 3] of the joints as predicted.
            contacts: [4] in [0, 1].
        """
        feet = positions[self.body.feet]
        self._update(feet, contacts)
        targets = feet + self.offsets
        targets[:, 1] = np.maximum(targets[:, 1], self.constants["floor"])
        needed = self.needed_drop(positions, targets)
        drop, speed = self._decay(self.drop[0] - needed, self.drop[1])
        self.drop = needed + drop, speed
        share = self.strength[1::2]
        return targets.reshape(2, 2, 3), share**2 * (3.0 - 2.0 * share), self.drop[0]

    def carry(self, turned, shift):
        """Rotates the locks about the origin by a unit number, then shifts them by a point on the ground."""
        self.places = to_world(self.places, turned, shift)
        self.offsets, self.velocities = to_world(self.offsets, turned), to_world(self.velocities, turned)

    def _update(self, feet, contacts):
        k, fps = self.constants, self.constants["fps"]
        self._come_down(feet[:, 1])
        gap = self.places - feet
        kept = self.held & (contacts >= k["release_threshold"]) & self._near(gap)
        leads = kept[PARTNER][:, None]  # a joint that is not held follows its held partner
        goal, before, pull = (np.where(leads, v[PARTNER], 0.0) for v in (gap, self.offsets, self.velocities))
        away, away_velocity = self._decay(self.offsets - before, self.velocities - pull)
        free = goal + away
        close = (away**2).sum(-1) < (k["max_lock_offset"] * self.leg_length) ** 2
        starting = ~self.held & (contacts >= k["lock_threshold"]) & close
        offsets = np.where(kept[:, None], gap, free)
        moving = away_velocity + np.where(leads, (goal - before) * fps, 0.0)
        self.places = np.where(starting[:, None], feet + free, self.places)
        self.settling = np.where(starting, free[:, 1] - np.maximum(self.rest - feet[:, 1], 0.0), self.settling)
        self.sinking = np.where(starting, moving[:, 1], self.sinking)
        self.held = kept | starting
        change = np.where(self.held, 1.0 / k["lock_time"], -1.0 / k["release_time"]) / fps
        self.strength = np.clip(self.strength + change, 0.0, 1.0)
        self.velocities = np.where(kept[:, None], (offsets - self.offsets) * fps, moving)
        self.offsets = offsets

    def _come_down(self, heights):
        """Lowers the places to the lowest predicted heights [4] since each joint is held, but not below its rest."""
        before, rest = self.places[:, 1], self.rest
        lowest = np.maximum(np.minimum(before - self.settling, heights), rest)
        left, self.sinking = self._decay(self.settling, self.sinking)
        self.settling = np.maximum(left, np.minimum(before, rest) - lowest)
        self.places = np.stack([self.places[:, 0], lowest + self.settling, self.places[:, 2]], axis=1)

    def _near(self, gap):
        """Returns which joints [4] are near enough to where they are held, by the gaps [4, 3] to there."""
        k, away = self.constants, gap.copy()
        rise = np.array([k["heel_rise"], 1.0] * 2)  # heels leave the ground before toes
        away[:, 1] = np.maximum(-gap[:, 1], 0.0) * rise
        limits = np.array([k["heel_limit"], k["toe_limit"]] * 2) * self.leg_length
        return (away**2).sum(-1) < limits**2

    def _decay(self, offset, velocity):
        """Advances a critically damped spring with rest position 0 by one frame."""
        dt, rate = 1.0 / self.constants["fps"], self.constants["decayed"] / self.constants["release_time"]
        push, fade = velocity + rate * offset, np.exp(-rate * dt)
        return (offset + push * dt) * fade, (velocity - push * rate * dt) * fade

    def needed_drop(self, positions, targets):
        """Returns the metres by which the hips must sink for both heels to be within reach."""
        drops = []
        for side, (hip, knee, heel, _) in enumerate(self.body.legs):
            upper, lower, now = (
                np.linalg.norm(positions[a] - positions[b]) for a, b in ((knee, hip), (heel, knee), (heel, hip))
            )
            reach, to = max(0.995 * (upper + lower), now), targets[2 * side] - positions[hip]
            drops.append(-to[1] - np.sqrt(max(reach**2 - to[0] ** 2 - to[2] ** 2, 1e-6)))
        return np.clip(max(drops), 0.0, self.constants["max_drop"] * self.leg_length)
