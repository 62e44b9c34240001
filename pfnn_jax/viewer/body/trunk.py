"""The trunk: one closed surface from the crotch over waist and chest to the neck."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.retargeting.body import neck_chain, torso_chain
from pfnn_jax.viewer.body.anatomy import HIP, SHOULDER, TORSO, Anatomy
from pfnn_jax.viewer.body.part import Part, Weights, profile, smooth_step, tube, unit

CORNERS = 20
# Height (0 at the hip joints, 1 at the shoulder joints), and metres of a person: half the width, depth to the front and
# to the back, and how the width follows the hips (0) or the shoulders (1) of the skeleton.
PROFILE = (
    (-0.20, 0.012, 0.012, 0.020, 0.0),
    (-0.17, 0.040, 0.040, 0.055, 0.0),
    (-0.10, 0.090, 0.075, 0.090, 0.0),
    (0.00, 0.135, 0.086, 0.108, 0.0),
    (0.10, 0.150, 0.088, 0.110, 0.1),
    (0.22, 0.148, 0.090, 0.094, 0.2),
    (0.36, 0.132, 0.088, 0.076, 0.4),
    (0.48, 0.125, 0.086, 0.074, 0.5),
    (0.64, 0.138, 0.098, 0.090, 0.7),
    (0.80, 0.158, 0.112, 0.102, 1.0),
    (0.92, 0.160, 0.104, 0.102, 1.0),
    (1.00, 0.148, 0.080, 0.092, 1.0),
    (1.06, 0.122, 0.062, 0.080, 1.0),
    (1.11, 0.086, 0.053, 0.066, 0.8),
    (1.16, 0.062, 0.052, 0.056, 0.5),
)
STATIONS = np.array([-0.2, -0.17, -0.12, -0.06, 0.0, 0.08, 0.16, 0.26, 0.36, 0.48, 0.6, 0.72, 0.82, 0.9, 0.96, 1.01, 1.06, 1.11, 1.15])  # fmt: skip
NECK = ((0.0, 0.058, 0.052, 0.056), (0.5, 0.053, 0.050, 0.054), (1.0, 0.052, 0.050, 0.056))
NECK_STATIONS = np.array([0.35, 0.7, 1.0, 1.25])
SQUARE = 0.86  # exponent of the rings: 1 is an ellipse, less is squarer


def grow_trunk(anatomy: Anatomy, colour: np.ndarray) -> Part:
    """Returns the trunk with the neck, moved by hips, spine, neck, head and clavicles."""
    size, torso = anatomy.size, anatomy.torso
    low, up = anatomy.hip_middle, unit(anatomy.shoulder_middle - anatomy.hip_middle)
    values = profile(PROFILE, STATIONS)
    sides = np.clip([anatomy.hip_half / HIP, anatomy.shoulder_half / SHOULDER], 0.6 * size, 1.8 * size)
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
    along = (base - top) @ up
    return (top if abs(along) > 0.05 * anatomy.size else base), head


def _rings(widths: np.ndarray) -> np.ndarray:
    """Returns the corners [R, N, 2] of rings that are a little squarer than ellipses."""
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    c, s = np.cos(angles), np.sin(angles)
    across, ahead = np.sign(c) * np.abs(c) ** SQUARE, np.sign(s) * np.abs(s) ** SQUARE
    depth = np.where(ahead >= 0, widths[:, 1:2], widths[:, 2:3])
    return np.stack([widths[:, :1] * across, depth * ahead], axis=-1)


def _weights(anatomy: Anatomy, rings: np.ndarray, up: np.ndarray) -> list[Weights]:
    """Returns the weights of all vertices of the rings [R, N, 3], one after another."""
    body = anatomy.body
    chain = (*torso_chain(body), *neck_chain(body))
    heights = np.array([(anatomy.at(joint) - anatomy.hip_middle) @ up for joint in chain])
    points = rings.reshape(-1, 3)
    height = np.repeat((rings.mean(axis=1) - anatomy.hip_middle) @ up, rings.shape[1])
    shares = chain_shares(heights, height, 0.1 * anatomy.size)
    weights: list[Weights] = [
        {joint: share for joint, share in zip(chain, row, strict=True) if share > 0} for row in shares.tolist()
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        clavicle, arm = anatomy.limb(side, "clavicle", "upper_arm")
        if clavicle is None or arm is None:
            continue
        shoulder, inner = anatomy.at(arm), 0.3 * anatomy.shoulder_half
        out = smooth_step(2 * (sign * points[:, 0] - inner) / (anatomy.shoulder_half - inner) - 1)
        level = np.abs((points - shoulder) @ up) / (0.2 * anatomy.torso)
        pull = out * (1 - smooth_step(2 * level - 1))
        for vertex in np.flatnonzero(pull > 0.01):
            share = float(pull[vertex])
            row = {joint: (1 - share) * weight for joint, weight in weights[vertex].items()}
            row[clavicle] = row.get(clavicle, 0.0) + share
            weights[vertex] = row
    return weights


def chain_shares(starts: np.ndarray, at: np.ndarray, end: float) -> np.ndarray:
    """Returns the shares [N, C] of the bones of a chain in the movement of points along it.

    A bone moves the point in its middle alone; between the middles of two bones the share passes from one to the next.

    Args:
        starts: [C] positions along the chain at which the bones start.
        at: [N] positions of points.
        end: length of the last bone.
    """
    starts = np.maximum.accumulate(starts)
    middles = (starts + np.append(starts[1:], starts[-1] + end)) / 2
    shares = np.zeros((len(at), len(starts)))
    after = np.searchsorted(middles, at)
    first, last = np.clip(after - 1, 0, len(starts) - 1), np.clip(after, 0, len(starts) - 1)
    gap = np.maximum(middles[last] - middles[first], 1e-9)
    share = smooth_step(2 * np.clip((at - middles[first]) / gap, 0, 1) - 1)
    rows = np.arange(len(at))
    shares[rows, first] += 1 - share
    shares[rows, last] += share
    return shares
