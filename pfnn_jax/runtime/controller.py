"""A character that a person drives: any style of a run, mixed, at any speed, from standing to standing.

`step` is a pure function of one character and one frame: use it in a loop, in `lax.scan` (`drive`), and under `vmap`
for crowds. Inside it is the published loop of `frame`; around that stand what an application needs besides: the mixing
of styles, and a body with rigid bones.

    controller = make_controller(run)
    state = controller.start()
    state = controller.step(state, Command(velocity=..., direction=..., style=controller.style_weights("Zombie")))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.models.adapters import OneHot
from pfnn_jax.models.film import Film
from pfnn_jax.models.film import mix as mix_parameters
from pfnn_jax.models.layers import MixedLayer
from pfnn_jax.motion.frame_layout import FrameLayout
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.runtime.embodiment import mix_rotations, predicted_contacts, predicted_rotations, turn_rotations
from pfnn_jax.runtime.foot_lock import FootLockConfig, FootLocks, initial_locks, lock_feet
from pfnn_jax.runtime.frame import Command, ControllerConfig, advance, network_input, published_step
from pfnn_jax.runtime.generate import controller_of, default_speed, told_speed
from pfnn_jax.runtime.ground import heading, mix, root_yaw, turn_towards
from pfnn_jax.runtime.limb_ik import reach_arms
from pfnn_jax.runtime.mixture import check_weights, load_bank
from pfnn_jax.runtime.pose import Pose, Rig, forward_kinematics, make_rig, pose_from_world
from pfnn_jax.runtime.predictor import Predictor, assemble_predictor, evaluate
from pfnn_jax.runtime.regulation import (
    REGULATIONS,
    STANDARD,
    Regulated,
    Regulation,
    ask,
    keep_pace,
    observe,
    turn_state,
    turning,
)
from pfnn_jax.runtime.state import (
    ROOT,
    CharacterState,
    initial_state,
    joint_root,
    place_state,
    standing_state,
    straight_row,
)
from pfnn_jax.training.run import Run, list_styles

STYLE_RATE = 0.06
"""Share per frame of the way from a character's style to the commanded one: nine tenths of it in 0.6 s."""

STYLE_SNAP = 1e-3
"""Weights nearer than this to the commanded ones are set to them, so that styles that are left cost nothing."""

AGNOSTIC = "agnostic"
"""What a network without any style is called."""

RUN_IN_FRAMES = 90
"""Frames that a character walks unseen before it stands at its start: from a mean pose into its style."""


@struct.dataclass(kw_only=True)
class ControllerParams:
    """The arrays of a controller.

    Attributes:
        predictor: network and statistics, without a style.
        bank: C styles, leaves [C, ...]; rows beyond the named ones are zeros. None where the run has no styles.
        speeds: [C] m/s, the styles' own; 0 where it is not known.
        speed: [] m/s, of a style that tells none.
        row: [Dx] the row of inputs, in layout units, from which a character sets out.
        phase: [] radians or [G]: at that row.
        rest: [4] metres, height of left heel, left toe, right heel, right toe on the ground.
    """

    predictor: Predictor
    bank: Any
    speeds: jax.Array
    speed: jax.Array
    row: jax.Array
    phase: jax.Array
    rest: jax.Array


@dataclass(frozen=True)
class ControllerSetup:
    """What a controller is compiled for.

    Attributes:
        layout: of the network's rows.
        config: constants of the published loop.
        rig: of the body.
        feet: when feet are held on the ground, or None for a body as the network predicts it.
        regulation: how strictly commands are kept, or None for the published loop alone.
        stands: whether the network was shown characters that stand; others are held still.
    """

    layout: FrameLayout
    config: ControllerConfig
    rig: Rig
    feet: FootLockConfig | None
    regulation: Regulation | None
    stands: bool


@struct.dataclass(kw_only=True)
class Still:
    """One predicted frame.

    Attributes:
        root, facing: [2] metres, and a unit vector, of the root that the joints belong to.
        joints: [J, 3] metres in the world, blended as the published loop blends them.
        rotations: [J, 4] in the world, wxyz.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
    """

    root: jax.Array
    facing: jax.Array
    joints: jax.Array
    rotations: jax.Array
    contacts: jax.Array


@struct.dataclass(kw_only=True)
class ControllerState:
    """One character between two frames.

    Attributes:
        motion: what the network reads and writes, after the frame `ahead`.
        behind, ahead: the two predicted frames between which the character is.
        clock: [] in (0, 1], how far it has come from the one to the other.
        style: [C] weights, on their way to the commanded ones.
        regulated: pace, and what else regulation remembers.
        root, facing: [2] metres on the ground, and the unit vector that it faces.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        feet: what holds them.
        pose: the body as it is drawn, with rigid bones.
        joints, world_rotations: [J, 3] metres and [J, 4], of the pose in the world.
    """

    motion: CharacterState
    behind: Still
    ahead: Still
    clock: jax.Array
    style: jax.Array
    regulated: Regulated
    root: jax.Array
    facing: jax.Array
    contacts: jax.Array
    feet: FootLocks
    pose: Pose
    joints: jax.Array
    world_rotations: jax.Array

    @property
    def pace(self) -> jax.Array:
        """[] its own seconds for each second of the world."""
        return self.regulated.pace


@dataclass(frozen=True, eq=False)
class Controller:
    """A run made ready to be driven; `make_controller` makes it.

    Attributes:
        params: its arrays.
        setup: what it is compiled for.
        styles: names of the first rows of the bank.
    """

    params: ControllerParams
    setup: ControllerSetup
    styles: tuple[str, ...]

    @property
    def capacity(self) -> int:
        """C, rows of the bank."""
        return len(self.params.speeds)

    def start(self, position: Any = (0.0, 0.0), yaw: Any = 0.0, style: str | int = 0) -> ControllerState:
        """A character that stands at `position` [2] metres and faces `yaw` radians, in a style by name or number."""
        index = self.styles.index(style) if isinstance(style, str) else style
        weights = jnp.zeros(self.capacity, jnp.float32).at[index].set(1.0)
        return start(self.setup, self.params, jnp.asarray(position, jnp.float32), jnp.float32(yaw), weights)

    def step(self, state: ControllerState, command: Command) -> ControllerState:
        """The state one frame later."""
        return step(self.setup, self.params, state, command)

    def style_weights(self, choice: str | Mapping[str, float]) -> np.ndarray:
        """[C] weights of a style by name, or of a mixture by names and weights that sum to one.

        Raises:
            InputError: for an unknown style, or weights that do not sum to one.
        """
        chosen = {choice: 1.0} if isinstance(choice, str) else dict(choice)
        check_weights(tuple(chosen.values()), "controller", "style weights")
        weights = np.zeros(self.capacity, np.float32)
        for name, weight in chosen.items():
            if name not in self.styles:
                raise InputError("controller", "style", name, f"must be one of {', '.join(self.styles)}")
            weights[self.styles.index(name)] = weight
        return weights


def make_controller(
    run: Run,
    styles: Sequence[str] | None = None,
    capacity: int | None = None,
    *,
    foot_ik: bool = True,
    regulated: bool = True,
) -> Controller:
    """A controller of a run.

    Args:
        run: as `load_run` returns it. Of a run without styles the network moves as it is, as the one style `AGNOSTIC`.
        styles: names; by default all of the run's.
        capacity: C, rows of the bank, at least the number of styles: spare rows take styles that are learned later
            without another compilation.
        foot_ik: hold feet that are in contact on the ground, and lay arms along the predicted positions.
        regulated: keep commands by pace and turning (`regulation`); off for the published loop alone.

    Raises:
        InputError: for an unknown style, styles of different kinds, or a FiLM run without styles.
    """
    names = tuple(list_styles(run.path) if styles is None else styles)
    if not names and run.config.adapter.kind == "film":
        raise InputError(run.path, "styles", "none", "a FiLM run needs at least one style to move")
    spare = max(capacity or 0, len(names)) - len(names) if names else 0
    bank = None
    if names:
        bank = jax.tree.map(
            lambda leaf: jnp.concatenate([jnp.asarray(leaf), jnp.zeros((spare, *leaf.shape[1:]), leaf.dtype)]),
            load_bank(run, names),
        )
    rig = make_rig(run.skeleton, run.path)
    speeds = [told_speed(run, name) or 0.0 for name in names] + [0.0] * spare
    if not names:
        names, speeds = (AGNOSTIC,), [default_speed(run, None)]
    speed, layout, normaliser = default_speed(run, None), run.layout, run.normaliser
    row = jnp.asarray(normaliser.inputs.mean, jnp.float32)
    params = ControllerParams(
        predictor=assemble_predictor(run.shared, None, normaliser),
        bank=bank,
        speeds=jnp.asarray(speeds, jnp.float32),
        speed=jnp.float32(speed),
        row=straight_row(layout, row, speed) if layout.next_frame else row,
        phase=jnp.float32(0.0) if normaliser.phases is None else jnp.asarray(normaliser.phases.mean, jnp.float32),
        rest=jnp.asarray(resting_heights(layout, normaliser, rig), jnp.float32),
    )
    regulation = REGULATIONS.get(layout.name, STANDARD) if regulated else None
    setup = ControllerSetup(
        layout, controller_of(run), rig, FootLockConfig() if foot_ik else None, regulation, layout.has_input("gait")
    )
    if not all(speeds[: len(names)]):
        params = replace(params, speeds=jnp.where(params.speeds > 0.0, params.speeds, natural_speeds(setup, params)))
    return Controller(params, setup, names)


def resting_heights(layout: FrameLayout, normaliser: Normaliser, rig: Rig) -> np.ndarray:
    """[4] metres: how high the joints of the feet are on the ground, where most frames of any gait have them: about a
    deviation below the mean."""
    blocks = [
        np.asarray(values)[layout.output_slice("joint_position")].reshape(-1, 3)[list(rig.feet), 1] * layout.length_unit
        for values in (normaliser.outputs.mean, normaliser.outputs.std)
    ]
    return blocks[0] - blocks[1]


@partial(jax.jit, static_argnums=0)
def natural_speeds(setup: ControllerSetup, params: ControllerParams) -> jax.Array:
    """[C] metres per second at which each style walks when nothing steers it."""
    layout = setup.layout

    def walk(weights: jax.Array) -> jax.Array:
        predictor = replace(params.predictor, style=mixed_style(params.bank, weights))

        def frame(state: CharacterState, _):
            y = evaluate(predictor, network_input(layout, state), state.phase)
            after = advance(layout, state, y, setup.config)
            return after, jnp.linalg.norm(after.positions[ROOT] - state.positions[ROOT]) * layout.fps

        state = initial_state(layout, params.row, params.phase, jnp.zeros(2, jnp.float32), jnp.zeros((), jnp.float32))
        return jnp.mean(jax.lax.scan(frame, state, length=4 * RUN_IN_FRAMES)[1][-RUN_IN_FRAMES:])

    return jax.vmap(walk)(jnp.eye(len(params.speeds), dtype=jnp.float32))


@partial(jax.jit, static_argnums=0)
def start(
    setup: ControllerSetup, params: ControllerParams, position: jax.Array, yaw: jax.Array, style: jax.Array
) -> ControllerState:
    """A character that stands at `position` [2] metres, facing `yaw` [] radians, in a style [C]."""
    layout, predictor = setup.layout, replace(params.predictor, style=mixed_style(params.bank, style))
    speed, ahead = _own_speed(params, style), jnp.asarray([0.0, 1.0], jnp.float32)
    zero = jnp.zeros((), jnp.float32)
    state = initial_state(layout, params.row, params.phase, jnp.zeros(2, jnp.float32), zero)
    command = Command(velocity=speed * ahead, direction=ahead)
    if setup.stands:
        state = standing_state(layout, params.row, jnp.zeros(2, jnp.float32), zero)
        command = Command(velocity=0.0 * ahead, direction=ahead)

    def frame(state: CharacterState, _):
        after, y = published_step(partial(evaluate, predictor), layout, state, command, setup.config)
        return after, (after, y, state.positions[ROOT], state.directions[ROOT])

    _, (states, ys, roots, facings) = jax.lax.scan(frame, state, length=RUN_IN_FRAMES)
    heights = states.joint_positions[:, np.array(setup.rig.feet), 1] - params.rest[None]
    unready = jnp.arange(RUN_IN_FRAMES) < RUN_IN_FRAMES // 2
    best = jnp.argmin(jnp.max(heights, axis=1) + unready)
    motion, y, root, facing = jax.tree.map(lambda leaf: leaf[best], (states, ys, roots, facings))
    turned = heading(yaw)
    placed = place_state(motion, position, yaw)
    angle = yaw - root_yaw(motion.directions[ROOT])
    still = _still(setup, params, placed, y, facing, angle)
    regulated = Regulated(
        pace=jnp.float32(1.0 if setup.regulation is None else 0.0),
        gain=jnp.float32(1.0),
        velocity=speed * ahead,
        off=zero,
    )
    pose = Pose(hips=still.joints[0], rotations=still.rotations)
    return _drawn(
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


@partial(jax.jit, static_argnums=0)
def step(setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command) -> ControllerState:
    """One character, one frame later."""
    style = state.style
    if command.style is not None:
        moved = mix(style, command.style, STYLE_RATE)
        style = jnp.where(jnp.abs(moved - command.style) < STYLE_SNAP, command.style, moved)
    predictor = replace(params.predictor, style=mixed_style(params.bank, style))
    own, fps, config = _own_speed(params, style), setup.layout.fps, setup.regulation
    regulated = state.regulated
    if config is not None:
        regulated = keep_pace(regulated, command.velocity, state.contacts, config)

    def due(inner: ControllerState) -> jax.Array:
        return inner.clock > 1.0

    def live(inner: ControllerState) -> ControllerState:
        """One frame of the character's own time."""
        before, regulated = inner.motion, inner.regulated
        asked = command
        if config is not None:
            asked = ask(command, own, before, regulated, setup.config, config)
        motion, y = published_step(partial(evaluate, predictor), setup.layout, before, asked, setup.config)
        angle = jnp.zeros((), y.dtype)
        if config is not None:
            regulated = observe(regulated, before, motion, command, fps, config)
            angle = turning(regulated, command.velocity, fps, config)
            motion = turn_state(motion, angle)
        ahead = _still(setup, params, motion, y, before.directions[ROOT], angle)
        return replace(
            inner, motion=motion, regulated=regulated, behind=inner.ahead, ahead=ahead, clock=inner.clock - 1.0
        )

    state = replace(state, style=style, regulated=regulated, clock=state.clock + regulated.pace)
    return _drawn(setup, jax.lax.while_loop(due, live, state))


@partial(jax.jit, static_argnums=0)
def drive(
    setup: ControllerSetup, params: ControllerParams, state: ControllerState, commands: Command
) -> tuple[ControllerState, ControllerState]:
    """A character under a command for every frame: the last state, and all of them, leaves [T, ...]."""

    def frame(state: ControllerState, command: Command):
        state = step(setup, params, state, command)
        return state, state

    return jax.lax.scan(frame, state, commands)


def mixed_style(bank: Any, weights: jax.Array) -> Any:
    """The weighted sum of what C styles add: Films and one-hot shifts by parameters, residuals by their outputs."""
    if bank is None:
        return None
    if isinstance(bank, Film | OneHot):
        return mix_parameters(bank, weights)
    return MixedLayer(layers=bank, weights=weights)


def _own_speed(params: ControllerParams, style: jax.Array) -> jax.Array:
    """[] m/s at which a mixture of styles walks by itself."""
    return jnp.dot(style, jnp.where(params.speeds > 0.0, params.speeds, params.speed))


def _still(
    setup: ControllerSetup,
    params: ControllerParams,
    motion: CharacterState,
    y: jax.Array,
    facing: jax.Array,
    angle: jax.Array,
) -> Still:
    """The frame of y [Dy], predicted for a root facing [2]; the character has been turned by an angle [] since."""
    index = joint_root(setup.layout)
    return Still(
        root=motion.positions[index],
        facing=motion.directions[index],
        joints=motion.joint_positions,
        rotations=turn_rotations(predicted_rotations(setup.layout, y, facing), angle),
        contacts=predicted_contacts(setup.layout, y, motion, setup.rig, params.rest),
    )


def _drawn(setup: ControllerSetup, state: ControllerState) -> ControllerState:
    """The state with the body of its moment between two frames."""
    behind, ahead, share = state.behind, state.ahead, state.clock
    predicted = mix(behind.joints, ahead.joints, share)
    contacts = mix(behind.contacts, ahead.contacts, share)
    pose = pose_from_world(setup.rig, predicted[0], mix_rotations(behind.rotations, ahead.rotations, share))
    feet = state.feet
    if setup.feet is not None:
        # A foot that stands stays where it is while the character does, whatever its network says of it.
        held = jnp.where(state.regulated.pace > 0.0, contacts, jnp.where(feet.held, 1.0, contacts))
        pose, feet = lock_feet(setup.rig, reach_arms(setup.rig, pose, predicted), held, feet, setup.feet)
    joints, world = forward_kinematics(setup.rig, pose)
    return replace(
        state,
        root=mix(behind.root, ahead.root, share),
        facing=turn_towards(behind.facing, ahead.facing, share),
        contacts=contacts,
        feet=feet,
        pose=pose,
        joints=joints,
        world_rotations=world,
    )
