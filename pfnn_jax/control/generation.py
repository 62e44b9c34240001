"""Motion in a style along a path, in memory: by a tracked character, or by the published loop alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.compiling import jit_quickly
from pfnn_jax.control.controller import Controller, Embodiment, assemble_controller, step
from pfnn_jax.control.controller_state import ControllerParams, ControllerSetup, ControllerState, style_speed
from pfnn_jax.control.ik.fix_feet import fix_feet
from pfnn_jax.control.ik.pose import Pose
from pfnn_jax.control.loop.pursuit import TimedPath, advance_progress, make_timed_path, pursue
from pfnn_jax.control.loop.rollout import EvaluateFn, Frames, follow_path, warm_up
from pfnn_jax.control.loop.state import CharacterState, contacts_of_output, initial_state, place_state, straight_row
from pfnn_jax.control.loop.step import Command, LoopConfig, published_step
from pfnn_jax.control.run_settings import mean_speed
from pfnn_jax.errors import InputError
from pfnn_jax.inference.lookup import table_phase
from pfnn_jax.inference.modes import Mode
from pfnn_jax.inference.predictor import Predictor, assemble_predictor, evaluate
from pfnn_jax.models.network import Network
from pfnn_jax.models.placement import commit
from pfnn_jax.models.style import Style
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.features.decode import clip_from_outputs
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.ground import facing_of, to_local
from pfnn_jax.motion.kinematics import quat_normalise
from pfnn_jax.motion.paths import Path, make_path
from pfnn_jax.motion.skeleton import Skeleton


def _nearest50(predictor: Predictor, x: jax.Array, phase: jax.Array) -> jax.Array:
    return evaluate(predictor, x, table_phase(phase, "nearest50"))


def _constant50(predictor: Predictor, x: jax.Array, phase: jax.Array) -> jax.Array:
    return evaluate(predictor, x, table_phase(phase, "constant50"))


EVALUATORS: dict[Mode, EvaluateFn] = {"cubic": evaluate, "nearest50": _nearest50, "constant50": _constant50}
"""How `rollout` and `follow_path` evaluate a `Predictor` in each mode. A scan needs no table: it blends the network at
the table's phase, which is the same to rounding and gathers nothing."""

Item = TypeVar("Item")

WARM_UP_FRAMES = 60
"""Frames of straight walking before a path begins: the mean pose is not a valid pose; a few steps converge to the gait
cycle."""

BLOCK = 120
"""Frames that are compiled at once: walks of any length are made of such blocks, and cut."""

STANDING_SECONDS = 1.0
"""Seconds added to those of a path: a tracked character starts standing, and comes to stand."""


@dataclass(frozen=True, eq=False)
class GeneratedWalk:
    """A generated clip and what the network predicted for its frames.

    Attributes:
        clip: rigid bones, joint rotations from the network; write it with `pfnn_jax.motion.write_bvh`.
        phase: [T] radians, or [T, G] in layout units: the gating input of every frame.
        contacts: [T, 4] in [0, 1], left heel, left toe, right heel, right toe; None for a layout without contacts in
            the published loop.
        joints: [T, J, 3] metres in the world: as the network predicted them, or of a tracked character as drawn.
    """

    clip: MotionClip
    phase: np.ndarray
    contacts: np.ndarray | None
    joints: np.ndarray


def generate(
    network: Network,
    style: Style | None,
    path: Path | str | FilePath,
    body: Embodiment,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    natural_speed: float | None = None,
    loop: LoopConfig | None = None,
    foot_ik: bool = True,
    published_loop: bool = False,
) -> MotionClip:
    """Returns motion in a style along a path.

    By default the character tracks the path (`tracking`): it starts standing, keeps to the path and the speed, and
    stops at the end of an open path.

    Args:
        network: style-agnostic parameters.
        style: of the motion; None for style-agnostic motion.
        path: a path in metres, the name of a shape (`straight`, `circle`, `figure-eight`), or a CSV file of points.
        body: layout, skeleton and normaliser of the network, as a `Dataset` or `Run` has them.
        speed: metres per second; by default the natural speed.
        seconds: duration; by default as long as the path takes at that speed.
        natural_speed: metres per second of the style in its data; by default that of the mean row of the data.
        loop: constants of the published loop, by default those of the layout.
        foot_ik: lock feet that are in contact.
        published_loop: leave speed and heading to the network, as the published demos do.

    Raises:
        InputError: for an unknown path, a speed or duration that is not positive, or motion that is not finite.
    """
    path = as_path(path)
    if not published_loop:
        styles = {} if style is None else {"style": style}
        speeds = {} if natural_speed is None else {"style": natural_speed}
        controller = assemble_controller(network, styles, body, speeds=speeds, loop=loop, foot_ik=foot_ik)
        weights = controller.style_weights(0)
        return track_path(controller, weights, path, body, speed=speed, seconds=seconds).clip
    speed = speed or natural_speed or mean_speed(body.layout, body.normaliser)
    predictor = assemble_predictor(network, style, body.normaliser)
    walk = loop_path(predictor, path, body, speed=speed, seconds=seconds, loop=loop)
    return (fix_walk(walk) if foot_ik else walk).clip


def as_path(path: Path | str | FilePath) -> Path:
    """Returns a path, the shape of a name, or the path in a CSV file.

    Raises:
        InputError: for an unknown shape that is not a file either, or a file that holds no path.
    """
    return path if isinstance(path, Path) else make_path(str(path))


def track_path(
    controller: Controller,
    weights: np.ndarray,
    path: Path,
    body: Embodiment,
    *,
    speed: float | None = None,
    seconds: float | None = None,
) -> GeneratedWalk:
    """Returns the walk of a controlled character along a path, from standing to standing.

    Args:
        controller: of the character.
        weights: [C] of its style.
        path: in metres; the character starts at its first point.
        body: the controller was made for.
        speed: metres per second; by default the natural speed.
        seconds: duration; by default as long as the path takes at that speed, and `STANDING_SECONDS`.

    Raises:
        InputError: for a speed or duration that is not positive, or motion that is not finite.
    """
    return track_walks(controller, [weights], path, body, speed=speed, seconds=seconds)[0]


def track_walks(
    controller: Controller,
    weights: Sequence[np.ndarray],
    path: Path,
    body: Embodiment,
    *,
    speed: float | None = None,
    seconds: float | None = None,
    lanes: int = 1,
) -> list[GeneratedWalk]:
    """Returns the walks of one controlled character in several styles along a path; see `track_path`.

    Args:
        controller, path, body, speed, seconds: as for `track_path`.
        weights: [C] of each style.
        lanes: as for `track_paths`.

    Raises:
        InputError: as `track_path`.
    """
    natural = [float(style_speed(controller.params, jnp.asarray(style)).natural) for style in weights]
    speeds = [own if speed is None else speed for own in natural]
    times = [path.length / max(own, 1e-6) + STANDING_SECONDS if seconds is None else seconds for own in speeds]
    counts = [_num_frames(body, own, time) for own, time in zip(speeds, times, strict=True)]
    tracked = track_paths(controller, weights, [path] * len(weights), speeds, max(counts), lanes=lanes)
    walks = []
    for frames, count in zip(tracked, counts, strict=True):
        kept = jax.tree.map(lambda leaf, n=count: leaf[:n], frames)
        clip = replace(clip_of_states(kept, body, "motion"), content="generated", source=_source(body))
        walks.append(GeneratedWalk(clip, kept.phase, kept.contacts, kept.joints))
    return walks


def clip_of_states(states: ControllerState | TrackedFrames, body: Embodiment, name: str) -> MotionClip:
    """Returns the drawn body of a controlled character, leaves [T, ...], as a clip whose content is `name`.

    Raises:
        InputError: naming it, if a value is not finite.
    """
    hips, rotations = (np.asarray(values, np.float64) for values in (states.pose.hips, states.pose.rotations))
    if not (np.isfinite(hips).all() and np.isfinite(rotations).all()):
        raise InputError(_source(body), name, "not finite", "choose another style: its rollout diverges")
    rotations = quat_normalise(rotations)  # of unit length in single precision only
    return MotionClip(body.skeleton, body.layout.fps, hips, rotations, content=name)


@struct.dataclass(kw_only=True)
class TrackedFrames:
    """What is kept of the frames of a tracked character, leaves [T, ...]; see `ControllerState`.

    Attributes:
        pose: the displayed body.
        joints: [T, J, 3] metres in the world.
        contacts: [T, 4] in [0, 1].
        phase: [T] radians or [T, G], of the network.
    """

    pose: Pose
    joints: Any
    contacts: Any
    phase: Any


def track_paths(
    controller: Controller,
    weights: Sequence[np.ndarray],
    paths: Sequence[Path],
    speeds: Sequence[float],
    num_frames: int,
    *,
    lanes: int = 1,
) -> list[TrackedFrames]:
    """Returns the frames, in NumPy, of characters that follow paths and stop at their ends, each from standing on.

    They walk side by side in blocks of `BLOCK` frames, so that walks of all lengths are compiled once.

    Args:
        controller: of the characters.
        weights: [C] of the style of each.
        paths: in metres, one for each, with at most `LEAST_POINTS` points or equally many; a character starts at its
            first point.
        speeds: metres per second to request, one for each.
        num_frames: T.
        lanes: their number is filled up to a multiple of this, so that about as many are compiled once.
    """
    count = len(paths)
    timed = [make_timed_path(path, speed) for path, speed in zip(paths, speeds, strict=True)]
    begin = [
        controller.start(path.points[0], path.start_yaw, _choice(style))
        for path, style in zip(paths, weights, strict=True)
    ]
    filled = fill_up(range(count), lanes)
    states, tracks = (_stacked([every[number] for number in filled]) for every in (begin, timed))
    states, progress = commit((states, np.zeros(len(filled), np.float32)))
    blocks = []
    for _ in range(-(-num_frames // BLOCK)):
        (states, progress), frames = _track_block(controller.setup, controller.params, states, tracks, progress)
        blocks.append(jax.tree.map(np.asarray, frames))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:num_frames], *blocks)
    return [jax.tree.map(lambda leaf, i=number: leaf[:, i], whole) for number in range(count)]


def fill_up(items: Sequence[Item], multiple: int) -> list[Item]:
    """Returns items, of which there is at least one, repeated in their order until they are a multiple."""
    return [items[number % len(items)] for number in range(-(-len(items) // multiple) * multiple)]


def _choice(weights: np.ndarray) -> dict[int, float]:
    """Returns the rows and weights of a mixture as a choice of style."""
    return {int(row): float(weights[row]) for row in np.flatnonzero(weights)}


def _stacked(trees: Sequence[Any]) -> Any:
    """Returns trees with their leaves stacked, in NumPy, because JAX would compile it."""
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *trees)


@partial(jax.jit, static_argnames="setup")
def track_block(
    setup: ControllerSetup, params: ControllerParams, states: ControllerState, paths: TimedPath, progress: jax.Array
) -> tuple[tuple[ControllerState, jax.Array], TrackedFrames]:
    """Moves N characters, leaves [N, ...], along paths for `BLOCK` frames.

    Args:
        setup, params: of the controller.
        states: of the characters.
        paths: of each, with its speed.
        progress: [N] metres along it.

    Returns:
        The last states and progress, and all frames [BLOCK, N, ...].
    """

    def frame(path: TimedPath, state: ControllerState, progress: jax.Array):
        progress = advance_progress(path, state.root, progress)
        return step(setup, params, state, pursue(path, state.motion, progress, setup.loop)), progress

    def frames(carry: tuple[ControllerState, jax.Array], _: None):
        states, progress = jax.vmap(frame)(paths, *carry)
        kept = TrackedFrames(
            pose=states.pose, joints=states.joints, contacts=states.contacts, phase=states.motion.phase
        )
        return (states, progress), kept

    # The characters within the loop, not a loop for each: the step is then traced once.
    return jax.lax.scan(frames, (states, progress), length=BLOCK)


_track_block = jit_quickly(track_block, static_argnums=0)


def loop_path(
    predictor: Predictor,
    path: Path,
    body: Embodiment,
    *,
    speed: float,
    seconds: float | None = None,
    mode: Mode = "cubic",
    loop: LoopConfig | None = None,
) -> GeneratedWalk:
    """Returns the walk of the published loop along a path, from a warmed-up stride on.

    Args:
        predictor: network, style and statistics.
        path: in metres; the character starts at its first point.
        body: the predictor was made for.
        speed: metres per second to request.
        seconds: duration; by default as long as the path takes at that speed.
        mode: how the network is evaluated.
        loop: constants of the loop, by default those of the layout.

    Raises:
        InputError: for an unknown mode, a table for a layout without a global phase, a speed or duration that is not
            positive, or motion that is not finite.
    """
    frames = loop_frames(predictor, path, body, speed=speed, seconds=seconds, mode=mode, loop=loop)
    clip = clip_from_frames(body.skeleton, body.layout, frames)
    contacts = contacts_of_output(body.layout, np.asarray(frames.outputs))
    clip = replace(clip, content="generated", source=_source(body))
    return GeneratedWalk(clip, np.asarray(frames.phase), contacts, np.asarray(frames.joint_positions, np.float64))


def loop_frames(
    predictor: Predictor,
    path: Path,
    body: Embodiment,
    *,
    speed: float,
    seconds: float | None = None,
    mode: Mode = "cubic",
    loop: LoopConfig | None = None,
) -> Frames:
    """Returns the frames of the published loop along a path, with the arguments and errors of `loop_path`."""
    layout = body.layout
    if mode not in EVALUATORS:
        raise InputError(_source(body), "mode", mode, f"must be {', '.join(EVALUATORS)}")
    if mode != "cubic" and layout.phase_kind != "global":
        raise InputError(_source(body), "mode", mode, f"must be cubic: layout {layout.name} has no global phase")
    seconds = path.length / max(speed, 1e-6) if seconds is None else seconds
    num_frames, evaluate_fn = _num_frames(body, speed, seconds), EVALUATORS[mode]
    state = walking_state(evaluate_fn, predictor, layout, body.normaliser, speed, config=loop)
    state = place_state(state, jnp.asarray(path.points[0], jnp.float32), jnp.float32(path.start_yaw))
    timed, blocks = make_timed_path(path, speed), []
    state, progress = commit((state, np.float32(0.0)))
    for _ in range(-(-num_frames // BLOCK)):
        block = _follow_block(evaluate_fn, predictor, layout, state, timed, BLOCK, progress, config=loop)
        state, progress = block.state, commit(np.asarray(block.progress)[-1])
        blocks.append(jax.tree.map(np.asarray, replace(block, state=None)))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:num_frames], *blocks)
    return whole  # without the last state, which is that of the end of a block


_follow_block = jit_quickly(follow_path, static_argnames=("evaluate_fn", "layout", "num_frames", "config"))


def fix_walk(walk: GeneratedWalk, *, arms: bool = False) -> GeneratedWalk:
    """Returns the walk with its feet locked while they are in contact, by `fix_feet`.

    Args:
        walk: of the published loop.
        arms: lay arms along the predicted joint positions, which the rotations of mixed styles may not fit.
    """
    return replace(walk, clip=fix_feet(walk.clip, walk.contacts, joints=walk.joints if arms else None))


def starting_row(layout: FrameLayout, normaliser: Normaliser, speed: float | jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns the row of inputs [Dx] and the gating input ([] phase or [G]) that a warm-up along +Z starts from.

    It is the mean of the network's inputs. Next-frame layouts are trained on walks and runs in all directions, so the
    trajectory of their mean does not move; they start with a straight trajectory at the given speed.

    Args:
        layout, normaliser: of the network, in the same units.
        speed: metres per second.
    """
    x = jnp.asarray(normaliser.inputs.mean)
    return straight_row(layout, x, speed) if layout.next_frame else x, jnp.asarray(normaliser.initial_phase())


@partial(jax.jit, static_argnames=("evaluate_fn", "layout", "config"))
def _warmed_up(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    state: CharacterState,
    command: Command,
    config: LoopConfig | None,
) -> CharacterState:
    def frame(state: CharacterState, command: Command):
        return published_step(partial(evaluate_fn, params), layout, state, command, config)

    return jax.tree.map(lambda leaf: leaf[-1], warm_up(frame, state, command, WARM_UP_FRAMES)[0])


def walking_state(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    normaliser: Normaliser,
    speed: float | jax.Array,
    *,
    config: LoopConfig | None = None,
) -> CharacterState:
    """Returns a character in its stride near the origin, after a warm-up from `starting_row` straight along +Z.

    Args:
        evaluate_fn, params, layout, config: as for `rollout`.
        normaliser: of the network.
        speed: metres per second.
    """
    row = starting_row(layout, normaliser, speed)
    return walking_state_from(evaluate_fn, params, layout, *row, speed, config=config)


def walking_state_from(
    evaluate_fn: EvaluateFn,
    params: Any,
    layout: FrameLayout,
    x: jax.Array,
    phase: jax.Array,
    speed: float | jax.Array,
    *,
    config: LoopConfig | None = None,
) -> CharacterState:
    """Returns a `walking_state` whose warm-up starts from a row of inputs x [Dx] and its gating input: arrays only,
    for use under `jit`, where a normaliser would be compiled in."""
    state = initial_state(layout, x, phase, jnp.zeros(2, jnp.float32), jnp.zeros((), jnp.float32))
    ahead = jnp.asarray([0.0, 1.0], jnp.float32)
    return _warmed_up(evaluate_fn, params, layout, state, Command(velocity=speed * ahead, direction=ahead), config)


def clip_from_frames(skeleton: Skeleton, layout: FrameLayout, frames: Frames) -> MotionClip:
    """Returns the clip of one character's frames: predicted rotations, hips where the blended pose has them.

    Raises:
        InputError: if a value is not finite, or the skeleton does not fit the layout.
    """
    y, yaw = np.array(frames.outputs, np.float64), np.asarray(frames.root_yaw, np.float64)
    roots, joints = np.asarray(frames.root_positions, np.float64), np.array(frames.joint_positions, np.float64)
    joints[..., [0, 2]] -= roots[:, None]
    local = to_local(joints, facing_of(yaw)) / layout.length_unit
    y[:, layout.output_slice("joint_position")] = local.reshape(len(y), -1)
    return clip_from_outputs(skeleton, layout, y, roots, yaw, layout.fps)


def _num_frames(body: Embodiment, speed: float, seconds: float) -> int:
    """Returns the number of frames of some seconds; refuses a speed or duration that is not positive."""
    for name, value in (("speed", speed), ("seconds", seconds)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(_source(body), name, value, "must be above 0")
    return max(round(seconds * body.layout.fps), 2)


def _source(body: Embodiment) -> str:
    """Returns the folder of a run or dataset, for messages."""
    return str(getattr(body, "path", "memory"))
