"""Builds description.json: everything an engine needs to run an exported network besides its weights."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import jax.numpy as jnp
import numpy as np

from pfnn_jax.control import tracking
from pfnn_jax.control.calibration import foot_heights
from pfnn_jax.control.controller_state import CONTACT_HEIGHT
from pfnn_jax.control.ik.foot_lock import DECAYED, FootLockConfig
from pfnn_jax.control.ik.pose import make_rig
from pfnn_jax.control.loop.state import NUM_POINTS, ROOT, straight_row
from pfnn_jax.control.run_settings import default_speed, loop_config
from pfnn_jax.control.stance import WALK_FRAMES, WARM_UP_FRAMES
from pfnn_jax.control.standing import StandingConfig
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.interop.export.walks import Walk, walks_of
from pfnn_jax.motion.features.layout import GAITS, TRAJECTORY_OFFSETS, FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.labels.contacts import MAX_HEIGHT, MAX_SPEED
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.units import block_unit
from pfnn_jax.run import Run

SCHEMA, VERSION = "pfnn_jax.export", 1
FILE = "description.json"


def describe(
    run: Run,
    format: str,
    layout: FrameLayout,
    normaliser: Normaliser,
    network: Mapping[str, Any],
    styles: Sequence[Mapping[str, Any]],
    choice: StyleChoice,
) -> dict[str, Any]:
    """Returns the contents of `description.json`.

    Args:
        run: the exported run.
        format: onnx, stablehlo or bins.
        layout: layout of the exported network: the run's own, except for `bins` of `mason2018`.
        normaliser: statistics in the units of that layout.
        network: files of the network and how to read them.
        styles: name, kind and files of every exported style; of the chosen one alone if there is a choice.
        choice: the exported choice of style, in which the start pose walks.

    Returns:
        A dict of numbers, strings, lists and dicts, ready for JSON.
    """
    exported = [style["name"] for style in styles] if choice is None else [choice] * len(styles)
    start, *walks = walks_of(run, [choice, *exported])
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "format": format,
        "pfnn_jax": importlib.metadata.version("pfnn-jax"),
        "fingerprint": run.fingerprint,
        "network": dict(network),
        "layout": describe_layout(layout),
        "normaliser": describe_normaliser(normaliser),
        "skeleton": skeleton_to_json(run.skeleton),
        "styles": [{**style, **asdict(walk)} for style, walk in zip(styles, walks, strict=True)],
        "loop": describe_loop(run),
        "controller": describe_controller(run),
        "start": describe_start(layout, normaliser, default_speed(run, None), start),
    }


def describe_layout(layout: FrameLayout) -> dict[str, Any]:
    """Describes the blocks of x and y: columns, factor to SI units, unit."""

    def blocks(names: Sequence[str], columns: Any, size: int) -> dict[str, Any]:
        return {
            name: {
                "columns": np.arange(size)[columns(name)].tolist(),
                "scale": block_unit(layout, name)[0],
                "unit": block_unit(layout, name)[1],
            }
            for name in names
        }

    return {
        "name": layout.name,
        "num_joints": layout.num_joints,
        "fps": layout.fps,
        "next_frame": layout.next_frame,
        "hips_heading": layout.hips_heading,
        "phase_kind": layout.phase_kind,
        "phase_size": layout.phase_size,
        "end_effectors": list(layout.ends),
        "gaits": list(GAITS) if layout.has_input("gait") else [],
        "trajectory_offsets": list(TRAJECTORY_OFFSETS),
        "input_size": layout.input_size,
        "output_size": layout.output_size,
        "inputs": blocks(layout.input_blocks, layout.input_slice, layout.input_size),
        "outputs": blocks(layout.output_blocks, layout.output_slice, layout.output_size),
    }


def describe_normaliser(normaliser: Normaliser) -> dict[str, list[float]]:
    """Returns means and standard deviations, in layout units."""
    sides = {"x": normaliser.inputs, "y": normaliser.outputs, "phase": normaliser.phases}
    return {
        f"{side}_{kind}": np.asarray(getattr(statistics, kind), np.float64).tolist()
        for side, statistics in sides.items()
        if statistics is not None
        for kind in ("mean", "std")
    }


def describe_loop(run: Run) -> dict[str, Any]:
    """Returns the constants of the published loop (`LoopConfig`) and the current trajectory index."""
    return {**asdict(loop_config(run)), "num_points": NUM_POINTS, "root": ROOT}


def describe_controller(run: Run) -> dict[str, Any] | None:
    """Returns what the controller adds to the published loop: constants of command tracking and of the foot lock, and
    the joints of legs and arms. None for a skeleton without roles, which has no controller."""
    if run.skeleton.roles is None:
        return None
    rig = make_rig(run.skeleton, run.path)
    config = asdict(tracking.TrackingConfig(fps=float(run.layout.fps)))
    names = ("STOP_SPEED", "MIN_WALK_SPEED", "DISTANCE_RISE")
    return {
        "tracking": config | {name.lower(): getattr(tracking, name) for name in names},
        "foot_lock": {**asdict(FootLockConfig()), "decayed": DECAYED},
        "standing": {**asdict(StandingConfig(fps=float(run.layout.fps))), "contact_height": CONTACT_HEIGHT},
        "legs": [list(leg) for leg in rig.legs],
        "arms": [list(arm) for arm in rig.arms],
        "chest": rig.chest,
        "leg_length": rig.leg_length,
        "foot_heights": foot_heights(run.layout, run.normaliser, rig).tolist(),
        "contact_speed": MAX_SPEED * rig.leg_length,
        "contact_height": MAX_HEIGHT * rig.leg_length,
        "warm_up_frames": [WARM_UP_FRAMES, WALK_FRAMES],
    }


def describe_start(layout: FrameLayout, normaliser: Normaliser, speed: float, walk: Walk) -> dict[str, Any]:
    """Returns a row x and a phase from which a walk along +Z can start, and its speeds.

    It is the row from which the controller starts: the mean pose on a straight trajectory at a speed in m/s.
    """
    x = np.asarray(straight_row(layout, jnp.asarray(normaliser.inputs.mean), speed), np.float64)
    return {"x": x.tolist(), "phase": np.asarray(normaliser.initial_phase(), np.float64).tolist(), **asdict(walk)}
