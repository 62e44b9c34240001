"""Every compiled function lowers for GPUs and TPUs, without host callbacks, 64-bit numbers or dynamic shapes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from pfnn_jax.control import controller as controlling
from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.generation import generate, track_path
from pfnn_jax.control.loop import rollout as rollouts
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.inference.lookup import evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import evaluate, make_predictor
from pfnn_jax.inference.rows import RowStyles, predict_rows
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.motion.paths import make_path
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, load_style
from pfnn_jax.training.config import FewShotConfig, Precision, PretrainConfig, TuningConfig
from pfnn_jax.training.data import make_gather
from pfnn_jax.training.few_shot_learning import few_shot
from pfnn_jax.training.loop import scan_steps
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import init_state, pretrain
from pfnn_jax.training.steps import Frozen, equal_dropout, make_pretrain_step
from pfnn_jax.training.tuning import tune_generator
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics, train_autoencoder
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import (
    AutoencoderTrainingConfig,
    OptimisationConfig,
    TransformationConfig,
    TransformationTrainingConfig,
)
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.pairing import GaitClip, pair_by_gait
from pfnn_jax.transfer.run import TransferRun, TransferRunConfig
from pfnn_jax.transfer.transformation_training import apply_network, train_transformation
from tests.interop.small_runs import make_run
from tests.lowering import PLATFORMS, compiled_functions, lower, lowering
from tests.training.toy import HIDDEN, body_rows, toy_network, toy_rows
from tests.transfer_runs import SMALL as FILTERS

PACKAGES = ("inference", "training", "control", "transfer")


def names(module: str, *functions: str) -> set[str]:
    return {f"pfnn_jax.{module}.{function}" for function in functions}


FRAMES = (
    names("control.calibration", "measure_walk_speed", "start_standing")
    | names("control.controller", "step")
    | names("control.loop.rollout", "locked_rollout", "rollout")
    | names("control.stance", "_walks")
)
LOOPS = (
    names("control.controller", "rollout_commands")
    | names("control.generation", "_warmed_up", "track_block")
    | names("control.ik.fix_feet", "_fix")
    | names("control.loop.rollout", "follow_path")
    | names("control.stability", "_stability", "_walk")
)
ROWS = names("inference.lookup", "_evaluate_slice") | names("inference.rows", "_evaluate_films", "_evaluate_rows")
TRANSFER = (
    names("transfer.optimisation", "_encode", "_optimise")
    | names("transfer.transformation_training", "_apply", "_batch_losses")
    | names("training.loop", "scan")
)
FEW_SHOT = names("training.few_shot_learning", "_row_errors", "_stack", "_train_many")
TUNING = names("training.loop", "one") | names("training.film_styles", "_generate")

PRODUCTS: dict[Precision, str] = {
    "float32": "precision = [HIGHEST, HIGHEST]",
    "tf32": "precision = [HIGH, HIGH]",
    "bfloat16": "lhs_precision_type = bf16, rhs_precision_type = bf16, accumulation_type = f32",
}
CONVOLUTIONS: dict[Precision, str] = {
    "float32": "#stablehlo<precision HIGHEST>, #stablehlo<precision HIGHEST>",
    "tf32": "#stablehlo<precision HIGH>, #stablehlo<precision HIGH>",
    "bfloat16": "",  # the device's own
}

SMALL: dict[str, Any] = {
    "hidden": HIDDEN,
    "batch_size": 4,
    "clips_per_batch": 2,
    "generator_filters": 4,
    "generator_width": 5,
    "generator_hidden": 8,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """A run of 2018: a global phase, and CP styles."""
    return make_run(tmp_path_factory.mktemp("cp") / "run", "mason2018", "cp")


@pytest.fixture(scope="module")
def film_run(tmp_path_factory) -> Run:
    """A run of 2022: local phases, and FiLM styles."""
    return make_run(tmp_path_factory.mktemp("film") / "run", "mason2022", "film")


def tiny_transfer_run() -> tuple[TransferRun, list[GaitClip]]:
    """Returns a run that is on no disk, and three clips."""
    clips = []
    for turn in (-0.5, 0.0, 0.5):
        walk, _ = synthesise("neutral", np.full(130, turn), np.full(130, 1.2), fps=60)
        clips.append(GaitClip(encode_clip(walk, HOLDEN2017), "walk", f"turn {turn}"))
    skeleton, statistics = synthetic_skeleton(), fit_statistics(clips[0].rows, HOLDEN2017)
    config = TransferRunConfig(HOLDEN2017.name, FILTERS, skeleton_to_json(skeleton))
    autoencoder = init_autoencoder(FILTERS, HOLDEN2017.size, key=jax.random.key(0))
    return TransferRun(Path("none"), config, HOLDEN2017, skeleton, statistics, autoencoder, "none"), clips


def control(run: Run) -> None:
    """Steps a controller, once and along commands, generates along a path in both ways, and judges on circles."""
    controller, style = make_controller(run), load_style(run, "style0")
    state, weights = controller.start(), jnp.asarray(controller.style_weights(0))
    command = Command(velocity=jnp.ones(2), direction=jnp.asarray([0.0, 1.0]), style=weights)
    controller.step(state, command)
    commands = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), command)
    x, y, phase = rows_of(run)
    predictor, alone = make_predictor(run, "style0"), dataclasses.replace(commands, style=None)
    rollouts.locked_rollout(evaluate, predictor, run.layout, jnp.asarray(x), jnp.asarray(phase))
    rollouts.rollout(evaluate, predictor, run.layout, state.motion, alone)
    if run.layout.next_frame:
        return  # what follows are loops of the same frames
    controlling.rollout_commands(controller.setup, controller.params, state, commands)
    track_path(controller, controller.style_weights(0), make_path("circle"), run, seconds=0.5)
    generate(run.shared, style, "circle", run, seconds=0.5, published_loop=True)
    make_stability_check(run.shared, run.normaliser, run.layout, x, y, phase)(style)


def rows_of(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns four rows in layout units."""
    layout, gating = run.layout, (run.layout.phase_size,) if run.layout.phase_size else ()
    x, y, phase = (np.ones((4, *shape), np.float32) for shape in ((layout.input_size,), (layout.output_size,), gating))
    return x, y, phase


@pytest.mark.parametrize(("kind", "rank"), [*((kind, None) for kind in style_kinds() if kind != "film"), ("cp", 2)])
def test_training_steps_of_every_kind_of_style(kind, rank):
    rows, config = toy_rows(), PretrainConfig(AdapterConfig(kind, 3), rank=rank, **SMALL)
    step = make_pretrain_step(optax.adam(1e-3), Objective(l1=0.1), equal_dropout(0.3))
    scan = scan_steps(step, make_gather(rows.layout))
    state = jax.eval_shape(lambda: init_state(config, rows.layout, len(rows.styles)))
    lower(scan, PLATFORMS, state, order_of(rows, 4, 0).draw(0, 2), rows.parts[0], Frozen(jax.random.key(0)))


@pytest.mark.parametrize("kind", ["cp", "film"])
def test_pretraining_with_gating_bones_and_pose_noise(kind):
    config = PretrainConfig(AdapterConfig(kind, 3), pose_noise=0.1, steps=1, **SMALL)
    with lowering(PACKAGES) as lowered:
        pretrain(body_rows(), config)
    assert lowered.keys() == names("training.loop", "one" if kind == "film" else "scan")


def test_tuning_of_a_generator():
    state = init_state(PretrainConfig(AdapterConfig("film"), **SMALL), body_rows().layout, 3)
    shared, generator = state.params.shared, state.params.modulation
    config = TuningConfig(steps=1, batch_size=4, clips_per_batch=2)
    with lowering(PACKAGES) as lowered:
        tune_generator(shared, generator, body_rows(num_frames=(30,)), config)
    assert lowered.keys() == TUNING


@pytest.mark.parametrize("method", ["cp_output", "film", "scratch"])
def test_few_shot_learning(method):
    config = FewShotConfig(method, rank=3, eval_epochs=(1,), batch_size=8)
    with lowering(PACKAGES) as lowered:
        few_shot(toy_network(), toy_rows((48,)), config)
    assert lowered.keys() == FEW_SHOT


@pytest.mark.parametrize("of_2022", [False, True])
def test_characters(run, film_run, of_2022):
    with lowering(PACKAGES) as lowered:
        control(film_run if of_2022 else run)
    assert lowered.keys() == FRAMES | (set() if of_2022 else LOOPS)


def test_rows(run, film_run):
    styles = RowStyles(np.asarray([[0, 1]] * 4), np.asarray([[0.5, 0.5]] * 4))
    with lowering(PACKAGES) as lowered:
        x, _, phase = rows_of(run)
        evaluate_lookup(make_lookup(make_predictor(run), 2), x[0], 0.0)
        predict_rows(run, x, phase, "style0")
        x, _, phase = rows_of(film_run)
        predict_rows(film_run, x, phase, styles)
    assert lowered.keys() == ROWS


def test_style_transfer():
    run, clips = tiny_transfer_run()
    rows, pairing = clips[0].rows, pair_by_gait(clips, clips[:1], HOLDEN2017)
    sizes = TransformationConfig(hidden=4, width=5)
    training = TransformationTrainingConfig(network=sizes, epochs=1, batch_size=2, held_out=0.3)
    windows = np.zeros((4, 10, HOLDEN2017.size), np.float32)
    with lowering(PACKAGES) as lowered:
        optimise(run, rows, [rows], OptimisationConfig(iterations=2, constraint_iterations=2), key=jax.random.key(0))
        network, _ = train_transformation(run, clips, clips[:1], pairing, training)
        apply_network(run, network, rows)
        train_autoencoder(windows, AutoencoderTrainingConfig(FILTERS, steps=2, dropout=0.2))
    assert lowered.keys() == TRANSFER


def train_pfnn(precision: Precision) -> None:
    pretrain(toy_rows(), PretrainConfig(AdapterConfig("cp", 3), precision=precision, steps=1, **SMALL))


def train_generator(precision: Precision) -> None:
    pretrain(body_rows(), PretrainConfig(AdapterConfig("film"), precision=precision, steps=1, **SMALL))


def train_style(precision: Precision) -> None:
    config = FewShotConfig("cp", rank=3, eval_epochs=(1,), batch_size=8, precision=precision)
    few_shot(toy_network(), toy_rows((48,)), config)


def train_motion(precision: Precision) -> None:
    windows = np.zeros((4, 10, HOLDEN2017.size), np.float32)
    train_autoencoder(windows, AutoencoderTrainingConfig(FILTERS, steps=2, precision=precision))


@pytest.mark.parametrize("precision", get_args(Precision))
@pytest.mark.parametrize(
    ("train", "name"),
    [
        (train_pfnn, "training.loop.scan"),
        (train_generator, "training.loop.one"),
        (train_style, "training.few_shot_learning._train_many"),
        (train_motion, "training.loop.scan"),
    ],
)
def test_every_product_of_a_training_has_its_precision(precision, train, name):
    """Those of gradients too."""
    with lowering(PACKAGES) as lowered:
        train(precision)
    lines = lowered[f"pfnn_jax.{name}"].splitlines()
    products = [line for line in lines if "stablehlo.dot_general" in line]
    convolutions = [line for line in lines if "stablehlo.convolution" in line]
    assert products or convolutions
    assert all(PRODUCTS[precision] in line for line in products)
    assert all(CONVOLUTIONS[precision] in line for line in convolutions)


def test_no_compiled_function_is_left_out():
    assert set(compiled_functions(PACKAGES)) <= FRAMES | LOOPS | ROWS | TRANSFER | FEW_SHOT | TUNING


def add_wide(x: jax.Array) -> jax.Array:
    return x.astype(jnp.float64).sum()


def ask_host(x: jax.Array) -> jax.Array:
    return jax.pure_callback(np.sin, x, x)


def test_what_must_not_be_lowered_is_found():
    x = jnp.ones(3)
    lower(jax.jit(jnp.sin), PLATFORMS, x)
    with pytest.raises(NotImplementedError):
        lower(jax.jit(ask_host), PLATFORMS, x)
    with jax.enable_x64(True), pytest.raises(AssertionError, match="64 bits"):
        lower(jax.jit(add_wide), PLATFORMS, x)
    (size,) = jax.export.symbolic_shape("n")
    with pytest.raises(AssertionError, match="dynamic"):
        lower(jax.jit(jnp.sin), PLATFORMS, jax.ShapeDtypeStruct((size,), jnp.float32))
