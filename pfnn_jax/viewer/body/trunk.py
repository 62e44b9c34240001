"""The trunk: one closed surface from the crotch over waist and chest to the neck."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.retargeting.body import neck_chain, torso_chain
from pfnn_jax.viewer.body.anatomy import HIP, SHOULDER, TORSO, Anatomy
from pfnn_jax.viewer.body.part import Part, Weights, profile, smooth_step, tube

CORNERS = 18
# Height (0 at the hip joints, 1 at the shoulder joints), and metres of a person: half the width, depth to the front and
# to the back, and how the width follows the hips (0) or the shoulders (1) of the skeleton.
PROFILE = (
    (-0.20, 0.012, 0.012, 0.020, 0.0),
    (-0.17, 0.040, 0.040, 0.055, 0.0),
    (-0.10, 0.092, 0.066, 0.092, 0.0),
    (0.00, 0.136, 0.076, 0.108, 0.0),
    (0.10, 0.149, 0.083, 0.110, 0.1),
    (0.22, 0.143, 0.089, 0.094, 0.2),
    (0.36, 0.125, 0.086, 0.076, 0.4),
    (0.48, 0.120, 0.085, 0.073, 0.5),
    (0.64, 0.140, 0.098, 0.088, 0.7),
    (0.80, 0.166, 0.112, 0.104, 1.0),
    (0.92, 0.178, 0.104, 0.104, 1.0),
    (1.00, 0.168, 0.084, 0.094, 1.0),
    (1.06, 0.134, 0.064, 0.082, 1.0),
    (1.11, 0.086, 0.052, 0.066, 0.8),
    (1.16, 0.058, 0.048, 0.053, 0.5),
)
STATIONS = np.array(
    [-0.2, -0.17, -0.12, -0.06, 0.0, 0.09, 0.18, 0.27, 0.36, 0.48, 0.6, 0.72, 0.82, 0.9, 0.96, 1.01, 1.06, 1.11, 1.15]
)
# Share of the way to the head joint: half the width, depth to the front and to the back of a person's neck.
NECK = ((0.0, 0.053, 0.046, 0.051), (0.5, 0.050, 0.045, 0.049), (1.0, 0.047, 0.042, 0.045), (1.3, 0.038, 0.036, 0.034))
NECK_STATIONS = np.array([0.35, 0.7, 1.0, 1.3])
NARROW = 0.65  # exponent: the trunk of a body with narrow shoulders is narrower, but less than in proportion
NECK_FROM = 1.04  # height above which the neck moves the trunk
BEND = 0.2  # half of the height over which the trunk bends at a joint of the spine
SHRUG = 0.75  # share of the clavicle in the movement of a shoulder
LOW_CLAVICLE = 0.14  # height of the shoulder above the clavicle's joint from which on it moves all of the chest
# Part that a clavicle moves: distance from the middle, in half the shoulders' width; that over which its share grows to
# either side; and height above and below the shoulder.
SHOULDER_PART, CHEST_PART = np.array([0.65, 0.25, 0.12]), np.array([0.2, 0.8, 0.3])
SQUARE = 0.86  # exponent of the rings: 1 is an ellipse, less is squarer


def grow_trunk(anatomy: Anatomy, colour: np.ndarray) -> Part:
    """Returns the trunk with the neck, moved by hips, spine, neck, head and clavicles."""
    size, torso = anatomy.size, anatomy.torso
    low, up = anatomy.hip_middle, unit(anatomy.shoulder_middle - anatomy.hip_middle)
    values = profile(PROFILE, STATIONS)
    ratios = np.array([anatomy.hip_half / HIP, anatomy.shoulder_half / SHOULDER]) / size
    sides = size * np.clip(ratios**NARROW, 0.6, 1.8)
    depth = np.sqrt(size * torso / TORSO)
    wide = values[:, 0] * ((1 - values[:, 3]) * sides[0] + values[:, 3] * sides[1])
    widths = np.stack([wide, depth * values[:, 1], depth * values[:, 2]], axis=-1)
    centres = low + torso * STATIONS[:, None] * up
    base, head = _neck(anatomy, centres[-1], up)
    neck = base + NECK_STATIONS[:, None] * (head - base)
    # the line bends from the trunk's to the neck's
    bent = smooth_step((STATIONS - 1.0) / 0.16)[:, None] * (STATIONS > 1.0)[:, None]
    centres = centres + bent * (base - centres[-1])
    centres = np.concatenate([centres, neck])
    widths = np.concatenate([widths, size * profile(NECK, NECK_STATIONS)])
    left = np.array([1.0, 0.0, 0.0])
    front = unit(np.cross(left, up))
    rings = centres[:, None] + _rings(widths) @ np.stack([left, front])
    return tube(rings, _weights(anatomy, rings, up), colour)


def _neck(anatomy: Anatomy, top: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the base of the neck and the base of the head [3]."""
    chain = neck_chain(anatomy.body)
    head = anatomy.at(chain[-1]) if chain else top + 0.08 * anatomy.size * up
    if (head - top) @ up < 0.03 * anatomy.size:  # no neck: the head sits on the trunk
        return top, top + 0.03 * anatomy.size * up
    base = anatomy.at(chain[0]) if len(chain) > 1 else top
    return (base if 0.0 < (base - top) @ up < 0.05 * anatomy.size else top), head


def _rings(widths: np.ndarray) -> np.ndarray:
    """Returns the corners [R, N, 2] of rings that are a little squarer than ellipses."""
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    c, s = np.cos(angles), np.sin(angles)
    across, ahead = np.sign(c) * np.abs(c) ** SQUARE, np.sign(s) * np.abs(s) ** SQUARE
    depth = np.where(ahead >= 0, widths[:, 1:2], widths[:, 2:3])
    return np.stack([widths[:, :1] * across, depth * ahead], axis=-1)


def _weights(anatomy: Anatomy, rings: np.ndarray, up: np.ndarray) -> list[Weights]:
    """Returns the weights of all vertices of the rings [R, N, 3], one after another."""
    body, torso = anatomy.body, anatomy.torso
    spine, neck = torso_chain(body), neck_chain(body)
    starts = np.array([(anatomy.at(joint) - anatomy.hip_middle) @ up for joint in (*spine, *neck)])
    # the joint of the neck may lie in the middle of the chest, which does not nod
    starts[len(spine) :] = np.maximum(starts[len(spine) :], NECK_FROM * torso)
    points = rings.reshape(-1, 3)
    heights = np.repeat((rings.mean(axis=1) - anatomy.hip_middle) @ up, rings.shape[1])
    shares = chain_shares(starts, heights, BEND * torso)
    weights: list[Weights] = [
        {joint: share for joint, share in zip((*spine, *neck), row, strict=True) if share > 0}
        for row in shares.tolist()
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        clavicle, arm = anatomy.limb(side, "clavicle", "upper_arm")
        if clavicle is None or arm is None:
            continue
        # a clavicle that starts in the middle of the chest moves all of it, one at the collar only the shoulder
        low = np.clip(float((anatomy.at(arm) - anatomy.at(clavicle)) @ up) / (LOW_CLAVICLE * torso), 0.0, 1.0)
        begin, width, height = (1 - low) * SHOULDER_PART + low * CHEST_PART
        out = smooth_step((sign * points[:, 0] / anatomy.shoulder_half - begin) / width)
        level = smooth_step(1.5 - np.abs((points - anatomy.at(arm)) @ up) / (height * torso))
        pull = SHRUG * out * level
        for vertex in np.flatnonzero(pull > 0.01):
            share = float(pull[vertex])
            row = {joint: (1 - share) * weight for joint, weight in weights[vertex].items()}
            row[clavicle] = row.get(clavicle, 0.0) + share
            weights[vertex] = row
    return weights


def chain_shares(starts: np.ndarray, at: np.ndarray, reach: float) -> np.ndarray:
    """Returns the shares [N, C] of the bones of a chain in the movement of points along it.

    Every joint is a smooth passage from the bone before to the bone after it, so that bones without a length are
    passed over.

    Args:
        starts: [C] positions along the chain at which the bones start.
        at: [N] positions of points.
        reach: half of the length over which a joint bends.
    """
    starts = np.maximum.accumulate(starts[1:])
    passed = smooth_step((at[:, None] - starts) / reach)
    ones, zeros = np.ones((len(at), 1)), np.zeros((len(at), 1))
    return -np.diff(np.concatenate([ones, passed, zeros], axis=1), axis=1)
