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
from dataclasses import dataclass
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
from pfnn_jax.runtime.blocks import read_block
from pfnn_jax.runtime.frame import Command, ControllerConfig, published_step
from pfnn_jax.runtime.generate import controller_of
from pfnn_jax.runtime.ground import mix, orthonormal, to_world
from pfnn_jax.runtime.mixture import check_weights, load_bank
from pfnn_jax.runtime.predictor import Predictor, assemble_predictor, evaluate
from pfnn_jax.runtime.state import ROOT, CharacterState, standing_state
from pfnn_jax.training.run import Run, list_styles

STYLE_RATE = 0.06
"""Share per frame of the way from a character's style to the commanded one: nine tenths of it in 0.6 s."""

STYLE_SNAP = 1e-3
"""Weights nearer than this to the commanded ones are set to them, so that styles that are left cost nothing."""


@struct.dataclass(kw_only=True)
class ControllerParams:
    """The arrays of a controller.

    Attributes:
        predictor: network and statistics, without a style.
        bank: C styles, leaves [C, ...]; rows beyond the named ones are zeros.
        stand: [Dx] the row of inputs, in layout units, in whose pose a character begins.
        stand_output: [Dy] the row of outputs whose rotations and contacts it begins with.
    """

    predictor: Predictor
    bank: Any
    stand: jax.Array
    stand_output: jax.Array


@dataclass(frozen=True)
class ControllerSetup:
    """What a controller is compiled for.

    Attributes:
        layout: of the network's rows.
        config: constants of the published loop.
    """

    layout: FrameLayout
    config: ControllerConfig
    parents: tuple[int, ...]
    offsets: tuple[tuple[float, ...], ...]


@struct.dataclass(kw_only=True)
class ControllerState:
    """One character between two frames.

    Attributes:
        motion: what the network reads and writes.
        style: [C] weights, on their way to the commanded ones.
        joints: [J, 3] metres, the body's joints in the world, with rigid bones.
        world_rotations: [J, 4] its rotations in the world, wxyz.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
    """

    motion: CharacterState
    style: jax.Array
    joints: jax.Array
    world_rotations: jax.Array
    contacts: jax.Array


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

    def start(self, position: Any = (0.0, 0.0), yaw: Any = 0.0, style: str | int = 0) -> ControllerState:
        """A character that stands at `position` [2] metres and faces `yaw` radians, in a style by name or number."""
        index = self.styles.index(style) if isinstance(style, str) else style
        weights = jnp.zeros(len(jax.tree.leaves(self.params.bank)[0])).at[index].set(1.0)
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
        weights = np.zeros(len(jax.tree.leaves(self.params.bank)[0]), np.float32)
        for name, weight in chosen.items():
            if name not in self.styles:
                raise InputError("controller", "style", name, f"must be one of {', '.join(self.styles)}")
            weights[self.styles.index(name)] = weight
        return weights


def make_controller(
    run: Run, styles: Sequence[str] | None = None, capacity: int | None = None, *, foot_ik: bool = True
) -> Controller:
    """A controller of a run.

    Args:
        run: as `load_run` returns it.
        styles: names; by default all of the run's.
        capacity: C, rows of the bank, at least the number of styles: spare rows take styles that are learned later
            without another compilation.
        foot_ik: hold feet that are in contact on the ground.

    Raises:
        InputError: for an unknown style, styles of different kinds, or a run without styles.
    """
    names = tuple(list_styles(run.path) if styles is None else styles)
    if not names:
        raise InputError(run.path, "styles", "none", "a controller needs at least one style")
    spare = max(capacity or 0, len(names)) - len(names)
    bank = jax.tree.map(
        lambda leaf: jnp.concatenate([jnp.asarray(leaf), jnp.zeros((spare, *leaf.shape[1:]), leaf.dtype)]),
        load_bank(run, names),
    )
    params = ControllerParams(
        predictor=assemble_predictor(run.shared, None, run.normaliser),
        bank=bank,
        stand=jnp.asarray(run.normaliser.inputs.mean, jnp.float32),
        stand_output=jnp.asarray(run.normaliser.outputs.mean, jnp.float32),
    )
    skeleton = run.skeleton
    setup = ControllerSetup(
        run.layout,
        controller_of(run),
        tuple(int(p) for p in skeleton.parents),
        tuple(tuple(float(v) for v in row) for row in skeleton.offsets),
    )
    return Controller(params, setup, names)


@partial(jax.jit, static_argnums=0)
def start(
    setup: ControllerSetup, params: ControllerParams, position: jax.Array, yaw: jax.Array, style: jax.Array
) -> ControllerState:
    """A character that stands at `position` [2] metres, facing `yaw` [] radians, in a style [C]."""
    motion = standing_state(setup.layout, params.stand, position, yaw)
    return _embody(setup, motion, style, params.stand_output, motion.positions[ROOT], motion.directions[ROOT])


@partial(jax.jit, static_argnums=0)
def step(setup: ControllerSetup, params: ControllerParams, state: ControllerState, command: Command) -> ControllerState:
    """One character, one frame later."""
    style = state.style
    if command.style is not None:
        moved = mix(style, command.style, STYLE_RATE)
        style = jnp.where(jnp.abs(moved - command.style) < STYLE_SNAP, command.style, moved)
    predictor = params.predictor.replace(style=mixed_style(params.bank, style))
    root, facing = state.motion.positions[ROOT], state.motion.directions[ROOT]
    motion, y = published_step(partial(evaluate, predictor), setup.layout, state.motion, command, setup.config)
    return _embody(setup, motion, style, y, root, facing)


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
    if isinstance(bank, Film | OneHot):
        return mix_parameters(bank, weights)
    return MixedLayer(layers=bank, weights=weights)


def _embody(
    setup: ControllerSetup, motion: CharacterState, style: jax.Array, y: jax.Array, root: jax.Array, facing: jax.Array
) -> ControllerState:
    """The rigid body of a state whose output y [Dy] was predicted from a root [2] facing [2]."""
    world = _world_rotations(setup.layout, y, facing)
    joints = [motion.joint_positions[0]]
    for parent, offset in zip(setup.parents[1:], setup.offsets[1:], strict=True):
        joints.append(joints[parent] + _rotate(world[parent], jnp.asarray(offset, world.dtype)))
    return ControllerState(
        motion=motion, style=style, joints=jnp.stack(joints), world_rotations=world, contacts=_contacts(setup.layout, y)
    )


def _contacts(layout: FrameLayout, y: jax.Array) -> jax.Array:
    if layout.has_output("contacts"):
        return jnp.clip(y[layout.output_slice("contacts")], 0.0, 1.0)
    if layout.has_output("foot_contacts"):
        right, left = jnp.clip(y[layout.output_slice("foot_contacts")], 0.0, 1.0)
        return jnp.stack([left, left, right, right])
    return jnp.zeros(4, y.dtype)


def _world_rotations(layout: FrameLayout, y: jax.Array, facing: jax.Array) -> jax.Array:
    if layout.has_output("joint_rotation"):
        half = read_block(layout, y, "joint_rotation", 3)
        angle = jnp.linalg.norm(half, axis=-1, keepdims=True)
        local = jnp.concatenate([jnp.cos(angle), half * jnp.sinc(angle / jnp.pi)], -1)
        yaw = jnp.arctan2(facing[0], facing[1]) / 2.0
        zero = jnp.zeros_like(yaw)
        return _multiply(jnp.stack([jnp.cos(yaw), zero, jnp.sin(yaw), zero])[None], local)
    forward, up = orthonormal(*(read_block(layout, y, name, 3) for name in ("joint_forward", "joint_up")))
    forward, up = to_world(forward, facing), to_world(up, facing)
    return _from_matrix(jnp.stack([jnp.cross(up, forward), up, forward], -1))


def _from_matrix(m: jax.Array) -> jax.Array:
    diagonal = jnp.diagonal(m, axis1=-2, axis2=-1)
    trace = diagonal.sum(-1)
    four = jnp.sqrt(jnp.maximum(jnp.concatenate([trace[:, None], 2.0 * diagonal - trace[:, None]], -1) + 1.0, 1e-12))
    w, x, y, z = four.T
    rows = [
        [w, (m[:, 2, 1] - m[:, 1, 2]) / w, (m[:, 0, 2] - m[:, 2, 0]) / w, (m[:, 1, 0] - m[:, 0, 1]) / w],
        [(m[:, 2, 1] - m[:, 1, 2]) / x, x, (m[:, 0, 1] + m[:, 1, 0]) / x, (m[:, 0, 2] + m[:, 2, 0]) / x],
        [(m[:, 0, 2] - m[:, 2, 0]) / y, (m[:, 0, 1] + m[:, 1, 0]) / y, y, (m[:, 1, 2] + m[:, 2, 1]) / y],
        [(m[:, 1, 0] - m[:, 0, 1]) / z, (m[:, 0, 2] + m[:, 2, 0]) / z, (m[:, 1, 2] + m[:, 2, 1]) / z, z],
    ]
    found = jnp.stack([jnp.stack(row, -1) for row in rows], -2)
    return 0.5 * jnp.take_along_axis(found, jnp.argmax(four, -1)[:, None, None], axis=-2)[:, 0]


def _multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return jnp.concatenate([aw * bw - (av * bv).sum(-1, keepdims=True), aw * bv + bw * av + jnp.cross(av, bv)], -1)


def _rotate(q: jax.Array, v: jax.Array) -> jax.Array:
    t = 2.0 * jnp.cross(q[1:], v)
    return v + q[0] * t + jnp.cross(q[1:], t)
