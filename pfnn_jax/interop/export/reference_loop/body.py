"""A body with rigid bones: forward kinematics, local rotations, arms and legs that reach for a point."""

import numpy as np

from .rotations import about, between, conjugate, cross, multiply, rotate

SOFT = 0.97  # share of a limb's length up to which targets are reached exactly, so that it never snaps straight
STRAIGHT = 1e-5  # of the cosine: a limb bends by at least a quarter of a degree
LEAN, BENT = 0.17, 0.5  # sines of 10 and 30 degrees: limbs bent by less lean to the pole; by more, keep their plane


class Body:
    """The skeleton of an export.

    Attributes:
        parents: [J], -1 for joint 0.
        offsets: [J, 3] metres from the parent, in the parent's frame.
        legs: (hip, knee, heel, toe) of the left and of the right leg.
        arms: joints of the left and of the right arm from shoulder to hand, or none.
        chest: the last joint above both arms, or None.
        resting_heights: [2, 2] metres of heel and toe of both feet above the floor while they stand flat, or None.
    """

    def __init__(self, skeleton, legs, arms, chest):
        self.parents, self.offsets = skeleton["parents"], np.array(skeleton["offsets"])
        self.legs, self.arms, self.chest = np.array(legs), arms, chest
        self.feet = self.legs[:, 2:].ravel()  # left heel, left toe, right heel, right toe
        self.resting_heights = skeleton["resting_heights"]
        depth = [0]
        for parent in self.parents[1:]:
            depth.append(depth[parent] + 1)
        above = np.array(self.parents)
        levels = (np.flatnonzero(np.array(depth) == level) for level in range(1, max(depth) + 1))
        self.levels = [(joints, above[joints]) for joints in levels]  # joints of one depth are computed at once

    def local_rotations(self, world):
        """Returns each joint's rotation [J, 4] in the frame of its parent; that of joint 0 is in the world."""
        local = multiply(conjugate(world[self.parents]), world)
        local[0] = world[0]
        return local

    def forward_kinematics(self, hips, local):
        """Returns positions [J, 3] and world rotations [J, 4], with joint 0 at `hips` [3]."""
        positions, world = np.zeros((len(local), 3)), local.copy()
        positions[0] = hips
        for joints, above in self.levels:
            positions[joints] = positions[above] + rotate(world[above], self.offsets[joints])
            world[joints] = multiply(world[above], local[joints])
        return positions, world

    def turn_joint(self, local, world, joint, turn):
        """Turns a joint, and all below it, by a rotation in the world; `world` is as before any turn."""
        parent = self.parents[joint]
        if parent >= 0:
            turn = multiply(conjugate(world[parent]), multiply(turn, world[parent]))
        local[joint] = multiply(turn, local[joint])

    def forward(self, positions):
        """Returns the horizontal direction [3], not unit, that the hips face."""
        across = positions[self.legs[0][0]] - positions[self.legs[1][0]]
        return np.array([-across[2], 0.0, across[0]])

    def reach_arms(self, hips, local, predicted):
        """Lays the arms along predicted joints [J, 3], bone by bone; mixed styles predict rotations that fit less."""
        local, (positions, world) = local.copy(), self.forward_kinematics(hips, local)
        for arm in self.arms:
            at, carried = positions[arm[0]], np.array([1.0, 0.0, 0.0, 0.0])
            for joint, below in zip(arm[:-1], arm[1:], strict=True):
                bone = rotate(carried, positions[below] - positions[joint])
                turn = between(bone, predicted[below] - at)
                at = at + rotate(turn, bone)
                self.turn_joint(local, world, joint, multiply(conjugate(carried), multiply(turn, carried)))
                carried = multiply(turn, carried)
        return local

    def place_leg(self, leg, local, world, positions, targets, toe_share):
        """Brings heel and toe to targets [2, 3]; where both cannot be met, the toe decides by its share."""
        hip, knee, heel, toe = leg
        foot, along = positions[toe] - positions[heel], targets[1] - targets[0]
        turn = between(foot, along)
        place = targets[0] + toe_share * (along - rotate(turn, foot))
        over, under = bend(positions[hip], positions[knee], positions[heel], place, self.forward(positions))
        self.turn_joint(local, world, hip, over)
        self.turn_joint(local, world, knee, under)
        self.turn_joint(local, world, heel, multiply(conjugate(multiply(over, under)), turn))

    def lift_heel(self, leg, positions, foot):
        """Returns a foot [2, 3] with its heel lifted towards the hip as far as the leg is too short for it."""
        hip, knee, heel, _ = positions[leg]
        reach = 0.995 * (np.linalg.norm(knee - hip) + np.linalg.norm(heel - knee))
        to, far = hip - foot[0], np.linalg.norm(hip - foot[0])
        over = max(far - max(reach, np.linalg.norm(heel - hip)), 0.0)
        return foot + [to * over / max(far, 1e-6), [0.0, 0.0, 0.0]]


def bend(upper, middle, end, target, pole):
    """Returns the rotations of a limb's two joints that bring its end to a target, the lower one applied first.

    The law of cosines gives the angle of the middle joint; the shortest arc then takes the end onto the ray to the
    target. A limb keeps the plane in which it bends, and a stretched one bends towards the pole [3].
    """
    u, v = middle - upper, end - middle
    axis = _hinge(u, v, pole)
    along, across = u @ v, cross(axis, v) @ u
    both, squares, bent = np.hypot(along, across), u @ u + v @ v, -np.arctan2(across, along)
    longest = np.sqrt(squares + 2.0 * both)
    distance = _soft(np.linalg.norm(target - upper), np.linalg.norm(end - upper), longest)
    cosine = (distance**2 - squares) / (2.0 * max(both, 1e-9))
    wanted = np.arccos(np.clip(cosine, STRAIGHT - 1.0, 1.0 - STRAIGHT))
    # A limb that is bent a little the wrong way, as by noise, stays so until more bending is needed.
    wanted = min(wanted, max(-wanted, 3.0 * wanted - 4.0 * max(-bent, 0.0)))
    under = about(axis, wanted - bent)
    return between(u + rotate(under, v), target - upper), under


def _hinge(u, v, pole):
    """Returns the unit axis about which a limb bends: of its own plane, or of the pole's if it is nearly straight."""
    natural = cross(pole, u)
    natural = natural / max(np.linalg.norm(natural), 1e-9)
    own = cross(u, v) / max(np.linalg.norm(u) * np.linalg.norm(v), 1e-9)
    share = min(own @ own / BENT**2, 1.0)
    axis = own + LEAN * (1.0 - share * (2.0 - share)) * natural
    return axis / max(np.linalg.norm(axis), 1e-9)


def _soft(wanted, now, longest):
    """Returns a distance that approaches the longest beyond both `SOFT` of it and the present distance."""
    start = max(SOFT * longest, min(now, longest))
    room = max(longest - start, 1e-6)
    return min(wanted, start) + room * (1.0 - np.exp(-max(wanted - start, 0.0) / room))
