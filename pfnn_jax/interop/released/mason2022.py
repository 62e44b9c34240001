"""Imports the local-phase network with 100 FiLM styles that Mason et al. (2022) released, as a run.

The release consists of little-endian float32 values, matrices as (outputs, inputs): experts
`cp{layer}_a{expert}.bin` and biases `cp{layer}_b{expert}.bin`, the gating network `wc{layer}_w.bin` and
`wc{layer}_b.bin`, statistics of inputs, outputs and local phases, and for every style four vectors predicted by the
FiLM generator, which is not released.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.inference.predictor import assemble_predictor, evaluate
from pfnn_jax.inference.style_choice import file_stem
from pfnn_jax.interop.released.files import read_array, read_description, read_statistics
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.gating import Gating
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network
from pfnn_jax.motion.features.layout import STYLE100_ENDS, layout_for, mason2022
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_forward_up, quat_rotate
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton, need_roles, skeleton_to_json
from pfnn_jax.run import Run, create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig

HIDDEN, EXPERTS, GATING_HIDDEN = 512, 8, 32

COMMAND_GAIN = 7.2
"""The authors' demo commands a walk with a speed of 6 and moves by velocity / 50 per frame: at 60 frames per second
that requests 7.2 m/s, for which the characters walk at about 1 m/s."""

SPEED = 1.0
"""Recorded speed of the imported styles, m/s: the demo's walk."""

# Joints 0 to 24 of the 100STYLE skeleton, including the end sites of the wrists, and their parents.
JOINTS: tuple[tuple[str, int], ...] = (
    ("Hips", -1), ("Chest", 0), ("Chest2", 1), ("Chest3", 2), ("Chest4", 3), ("Neck", 4), ("Head", 5),
    ("RightCollar", 4), ("RightShoulder", 7), ("RightElbow", 8), ("RightWrist", 9), ("RightWristSite", 10),
    ("LeftCollar", 4), ("LeftShoulder", 12), ("LeftElbow", 13), ("LeftWrist", 14), ("LeftWristSite", 15),
    ("RightHip", 0), ("RightKnee", 17), ("RightAnkle", 18), ("RightToe", 19),
    ("LeftHip", 0), ("LeftKnee", 21), ("LeftAnkle", 22), ("LeftToe", 23),
)  # fmt: skip

# In the order of the release: 95 training styles by name, then the five styles learned afterwards.
STYLES: tuple[str, ...] = tuple(
    """Aeroplane Akimbo Angry ArmsAboveHead ArmsBehindBack ArmsBySide ArmsFolded Balance BeatChest BentForward
    BentKnees BigSteps BouncyLeft BouncyRight Cat Chicken CrossOver Crouched CrowdAvoidance Depressed Dinosaur
    DragLeftLeg DragRightLeg Drunk DuckFoot Elated FairySteps Flapping FlickLegs Followed GracefulArms
    HandsBetweenLegs Heavyset HighKnees InTheDark KarateChop Kick LawnMower LeanBack LeanLeft LeanRight LeftHop
    LegsApart LimpLeft LimpRight LookUp Lunge March Monk Morris Neutral Old OnHeels OnPhoneLeft OnPhoneRight
    OnToesBentForward OnToesCrouched PendulumHands Penguin PigeonToed Proud Punch Quail RaisedLeftArm RaisedRightArm
    RightHop Robot Rocket Rushed ShieldedLeft ShieldedRight SlideFeet SpinAntiClock SpinClock StartStop Stiff
    Strutting Superman Swat Sweep Swimming SwingArmsRound SwingShoulders Teapot Tiptoe TogetherStep TwoFootJump
    WalkingStickLeft WalkingStickRight Waving WhirlArms WideLegs WiggleHips WildLegs Zombie
    HandsInPockets Roadrunner Skip Star WildArms""".split()
)


def import_released_lpn(directory: str | Path, out: str | Path, overwrite: bool = False) -> Run:
    """Imports a directory of released weights as a run of layout `mason2022`.

    Args:
        directory: contains `Xmean.bin`, `Xstd.bin`, `Ymean.bin`, `Ystd.bin`, `GT_Xmean.bin`, `GT_Xstd.bin`,
            `cp{0-2}_a{0-7}.bin`, `cp{0-2}_b{0-7}.bin`, `wc{0-2}_w.bin`, `wc{0-2}_b.bin` and
            `Style_{000-099}_{scale1,shift1,scale2,shift2}.bin`. A `description.json` next to them gives
            skeleton, sizes and styles; without one they are those of the released character.
        out: the run directory to write.
        overwrite: whether to replace an existing run.

    Returns:
        The run, with the styles of `STYLES` or of the description.

    Raises:
        InputError: if a file is missing, has the wrong size or is not finite; if `out` exists.
    """
    directory = Path(directory)
    description = read_description(directory, "mason2022")
    layout = mason2022(len(JOINTS)) if description is None else layout_for("mason2022", description["skeleton"])
    sides = (("X", layout.input_size), ("Y", layout.output_size), ("GT_X", layout.phase_size))
    normaliser = Normaliser(*(read_statistics(directory, side, size) for side, size in sides))
    sizes = (
        {"hidden": HIDDEN, "experts": EXPERTS, "gating_hidden": GATING_HIDDEN}
        if description is None
        else description["network"]
    )
    network = NetworkConfig(
        layout.input_size,
        layout.output_size,
        sizes["hidden"],
        sizes["experts"],
        phase_size=layout.phase_size,
        gating_hidden=sizes["gating_hidden"],
    )
    speeds = (
        dict.fromkeys(STYLES, SPEED)
        if description is None
        else {file_stem(s["name"]): s["speed"] for s in description["styles"]}
    )
    shared = _read_network(directory, network)
    styles = _read_styles(directory, len(speeds), network.hidden)
    config = RunConfig(
        network=network,
        adapter=AdapterConfig(kind="film"),
        layout=layout.name,
        num_joints=layout.num_joints,
        styles=tuple(speeds),
        skeleton=skeleton_to_json(
            _skeleton(shared, styles, normaliser, directory) if description is None else description["skeleton"]
        ),
        pretrain={"source": f"LPN weights in {directory.resolve().name}"},
        command_gain=COMMAND_GAIN if description is None else description["loop"]["command_gain"],
    )
    create_run(out, config, normaliser, overwrite)
    save_shared(out, shared)
    for index, (name, speed) in enumerate(speeds.items()):
        info = {"source": f"FiLM vectors in {directory.resolve().name}", "speed": speed}
        save_style(out, name, jax.tree.map(lambda leaf, i=index: leaf[i], styles), info)
    return load_run(out, layout.name)


def _read_network(directory: Path, config: NetworkConfig) -> Network:
    experts, hidden, width = config.num_control_points, config.hidden, config.gating_hidden
    sizes = (config.input_size, hidden, hidden, config.output_size)
    layers = []
    for layer, (i, o) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        weights = [read_array(directory / f"cp{layer}_a{expert}.bin", (o, i)).T for expert in range(experts)]
        biases = [read_array(directory / f"cp{layer}_b{expert}.bin", (o,)) for expert in range(experts)]
        layers.append(BlendedLayer(weights=jnp.asarray(np.stack(weights)), biases=jnp.asarray(np.stack(biases))))
    sizes = (config.phase_size, width, width, experts)
    gating = []
    for layer, (i, o) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        weights = read_array(directory / f"wc{layer}_w.bin", (o, i)).T
        gating.append(
            DenseLayer(
                weights=jnp.asarray(weights), biases=jnp.asarray(read_array(directory / f"wc{layer}_b.bin", (o,)))
            )
        )
    return Network(layers=(layers[0], layers[1], layers[2]), gating=Gating(layers=(gating[0], gating[1], gating[2])))


def _read_styles(directory: Path, num_styles: int, hidden: int) -> FiLMStyle:
    """Returns all styles stacked: leaves [S, 2, H]."""

    def read(kind: str) -> np.ndarray:
        rows = [
            read_array(directory / f"Style_{style:03d}_{kind}{layer}.bin", (hidden,))
            for style in range(num_styles)
            for layer in (1, 2)
        ]
        return np.stack(rows).reshape(num_styles, 2, hidden)

    return FiLMStyle(scale=jnp.asarray(read("scale")), shift=jnp.asarray(read("shift")))


def _skeleton(shared: Network, styles: FiLMStyle, normaliser: Normaliser, source: Path) -> Skeleton:
    """Reconstructs the skeleton of 100STYLE, whose offsets are not part of the release.

    The network predicts positions and rotations of all joints. The offset of a bone is its vector in the pose, rotated
    back by the parent's rotation and averaged over one pose of every style.
    """
    layout, predictor = mason2022(len(JOINTS)), assemble_predictor(shared, None, normaliser)

    @jax.jit
    def poses(bank: FiLMStyle) -> jax.Array:
        x, phase = predictor.input_mean, predictor.gating_mean
        assert phase is not None
        return jax.vmap(lambda style: evaluate(replace(predictor, style=style), x, phase))(bank)

    y = np.asarray(poses(styles), np.float64)
    positions, forward, up = (
        y[:, layout.output_slice(f"joint_{block}")].reshape(len(y), -1, 3) for block in ("position", "forward", "up")
    )
    parents = np.array([parent for _, parent in JOINTS])
    rotations = quat_from_forward_up(forward, up)
    offsets = quat_rotate(quat_conjugate(rotations)[:, parents], positions - positions[:, parents]).mean(axis=0)
    offsets[0] = 0.0
    leaves = sorted(set(range(len(JOINTS))) - set(parents.tolist()))
    skeleton = Skeleton(
        names=tuple(name for name, _ in JOINTS),
        parents=parents,
        offsets=offsets,
        end_sites=tuple((leaf, np.zeros(3)) for leaf in leaves),
        mirror=np.arange(len(JOINTS)),
    )
    found = assign_roles(skeleton, source=str(source))
    left_hand, right_hand, _, _ = STYLE100_ENDS
    return replace(found, roles=replace(need_roles(found), left_hand=left_hand, right_hand=right_hand))
