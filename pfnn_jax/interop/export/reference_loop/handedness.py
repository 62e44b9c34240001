"""Positions and rotations in the axes of an engine: left-handed Unity and Unreal, right-handed Godot and three.js.

Here (and in glTF, Godot and three.js): right-handed, metres, +Y up, the character faces +Z, its left is +X.
A mirror that changes the handedness takes a rotation about an axis to the opposite rotation about the mirrored axis.
Offsets of the rig change like positions; every local rotation changes by the same rule as a world rotation does.
"""

import numpy as np


def unity_positions(positions):
    """Returns positions [..., 3] for Unity: left-handed, metres, +Y up, faces +Z, left is -X."""
    return np.asarray(positions) * [-1.0, 1.0, 1.0]


def unity_rotations(rotations):
    """Returns rotations [..., 4] (wxyz) for Unity, as xyzw: the order of its `Quaternion(x, y, z, w)`."""
    w, x, y, z = np.moveaxis(np.asarray(rotations), -1, 0)
    return np.stack([x, -y, -z, w], -1)


def unreal_positions(positions):
    """Returns positions [..., 3] for Unreal: left-handed, centimetres, +Z up, faces +X, left is -Y."""
    x, y, z = np.moveaxis(np.asarray(positions), -1, 0)
    return 100.0 * np.stack([z, -x, y], -1)


def unreal_rotations(rotations):
    """Returns rotations [..., 4] (wxyz) for Unreal, as xyzw: the order of its `FQuat(X, Y, Z, W)`."""
    w, x, y, z = np.moveaxis(np.asarray(rotations), -1, 0)
    return np.stack([-z, x, -y, w], -1)
