"""How a driven character begins: standing, in the midst of a walk that nobody saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.character import (
    ControllerParams,
    ControllerSetup,
    ControllerState,
    drawn,
    frame_ahead,
    mixed_style,
    own_share,
    own_speed,
    still_frame,
)
from pfnn_jax.control.embodiment import feet_clearance
from pfnn_jax.control.ground import heading, root_yaw
from pfnn_jax.control.ik.foot_lock import initial_locks
from pfnn_jax.control.ik.pose import Pose, Rig
from pfnn_jax.control.loop.state import ROOT, CharacterState, initial_state, place_state, standing_state
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.tracking import LEAST_SPEED, begin
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser

SHARES = (0.2, 0.28, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0)
"""Of a style's own speed, tried by `find_walks`."""

WALKS = {"pfnn2017": 1.5}
"""Metres per second that a published demo asks of its network for a walk."""

UNBOUNDED = 1e3
"""Metres per second: of a style whose own speed is being found, which is not held back."""

RUN_IN_FRAMES = 90
"""Frames that a character walks unseen before it stands at its start: from a mean pose into its style."""


def mean_resting_heights(layout: FrameLayout, normaliser: Normaliser, rig: Rig) -> np.ndarray:
    """[4] metres: how high the joints of the feet are on the ground, where most frames of any gait have them: about a
    deviation below the mean."""
    blocks = [
        np.asarray(values)[layout.output_slice("joint_position")].reshape(-1, 3)[list(rig.feet), 1] * layout.length_unit
        for values in (normaliser.outputs.mean, normaliser.outputs.std)
    ]
    return blocks[0] - blocks[1]


def find_walks(setup: ControllerSetup, params: ControllerParams, rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """The speed at which each style walks, and the share of it to ask of the network, by trying.

    Networks answer speeds in their own way: some walk slower than they are asked to, and some that were shown walks and
    runs fall from walking into running at what is a walk's speed. Each style is tried at several speeds; taken is the
    one that leads nearest to its own and, as commands differ by as much, whose neighbours do so too; the greatest is
    tried as a neighbour only. The own speed of a style that tells none is what it makes of the published demo's walk,
    or of the speed of the data.

    Args:
        setup: of a controller.
        params: of the same; their bank has C rows.
        rows: S of them, the styles to try; `params.speeds` is what they tell.

    Returns:
        Speeds [S] metres per second, and shares [S].
    """
    chosen, count = np.asarray(rows, int), len(rows)
    told = np.asarray(params.speeds)[chosen]
    unknown = WALKS.get(setup.layout.name, float(params.speed))
    shares = np.asarray(SHARES if np.any(told > 0.0) else (1.0,))
    asked = np.where(told[:, None] > 0.0, told[:, None] * shares, unknown).astype(np.float32)
    styles, most = np.eye(len(params.speeds), dtype=np.float32)[chosen], np.where(told > 0.0, told, UNBOUNDED)
    found = np.asarray(settle(setup, params, styles, most.astype(np.float32), asked))
    found = np.maximum(found, LEAST_SPEED)  # NaN stays: of a network that fell apart
    own = np.where(told > 0.0, told, np.where(np.isfinite(found[:, 0]), found[:, 0], unknown))
    off = np.nan_to_num(np.abs(np.log(found / own[:, None])), nan=np.inf)
    padded = np.pad(off, ((0, 0), (1, 1)), mode="edge")
    worst = np.maximum(np.maximum(padded[:, :-2], padded[:, 2:]), off)
    best = np.argmin(worst[:, : max(len(shares) - 1, 1)], axis=1)
    return own, np.where(np.isfinite(off).any(1), asked[np.arange(count), best] / own, 1.0)


@partial(jax.jit, static_argnums=0)
def settle(
    setup: ControllerSetup, params: ControllerParams, styles: np.ndarray, own: np.ndarray, asked: np.ndarray
) -> jax.Array:
    """[S, A] metres per second at which styles [S, C] that walk at `own` [S] go straight on if asked for [S, A]."""
    layout = setup.layout

    def settled(style: jax.Array, own: jax.Array, speed: jax.Array) -> jax.Array:
        predictor, ahead = replace(params.predictor, style=mixed_style(params.bank, style)), jnp.asarray([0.0, 1.0])
        command = Command(velocity=speed * ahead, direction=ahead)

        def frame(state: CharacterState, _):
            after, _ = frame_ahead(setup, predictor, own, state, command)
            return after, jnp.linalg.norm(after.positions[ROOT] - state.positions[ROOT]) * layout.fps

        state = initial_state(layout, params.row, params.phase, jnp.zeros(2, jnp.float32), jnp.zeros((), jnp.float32))
        return jnp.mean(jax.lax.scan(frame, state, length=2 * RUN_IN_FRAMES)[1][RUN_IN_FRAMES:])

    return jax.vmap(jax.vmap(settled, in_axes=(None, None, 0)))(*map(jnp.asarray, (styles, own, asked)))


@partial(jax.jit, static_argnums=0)
def start(
    setup: ControllerSetup, params: ControllerParams, position: jax.Array, yaw: jax.Array, style: jax.Array
) -> ControllerState:
    """A character that stands at `position` [2] metres, facing `yaw` [] radians, in a style [C]."""
    layout, predictor = setup.layout, replace(params.predictor, style=mixed_style(params.bank, style))
    speed, ahead = own_speed(params, style), jnp.asarray([0.0, 1.0], jnp.float32)
    zero = jnp.zeros((), jnp.float32)
    state = initial_state(layout, params.row, params.phase, jnp.zeros(2, jnp.float32), zero)
    command = Command(velocity=own_share(params, style) * speed * ahead, direction=ahead)
    if layout.has_input("gait"):  # the network was shown characters that stand
        state = standing_state(layout, params.row, jnp.zeros(2, jnp.float32), zero)
        command = Command(velocity=0.0 * ahead, direction=ahead)

    def frame(state: CharacterState, _):
        after, y = frame_ahead(setup, predictor, speed, state, command)
        return after, (after, y, state.positions[ROOT], state.directions[ROOT])

    _, (states, ys, roots, facings) = jax.lax.scan(frame, state, length=RUN_IN_FRAMES)
    heights = states.joint_positions[:, np.array(setup.rig.feet), 1] - params.rest[None]
    unready = jnp.arange(RUN_IN_FRAMES) < RUN_IN_FRAMES // 2
    best = jnp.argmin(jnp.max(heights, axis=1) + unready)
    motion, y, root, facing = jax.tree.map(lambda leaf: leaf[best], (states, ys, roots, facings))
    turned = heading(yaw)
    placed = place_state(motion, position, yaw)
    angle = yaw - root_yaw(motion.directions[ROOT])
    still = still_frame(setup, params, placed, y, facing, angle)
    clearance = feet_clearance(placed, setup.rig, params.rest)
    regulated = begin(speed * ahead, clearance, 1.0 if setup.regulation is None else 0.0)
    pose = Pose(hips=still.joints[0], rotations=still.rotations)
    return drawn(
        setup,
        ControllerState(
            motion=replace(placed, target_velocity=speed * turned, target_direction=turned),
            behind=still,
            ahead=still,
            clock=jnp.float32(1.0),
            style=style,
            regulated=regulated,
            root=still.root,
            facing=still.facing,
            contacts=still.contacts,
            feet=initial_locks(setup.rig),
            pose=pose,
            joints=still.joints,
            world_rotations=still.rotations,
        ),
    )
