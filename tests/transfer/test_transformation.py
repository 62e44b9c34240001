"""The transformation network, its training on contents paired by gait, and its application to clips of any length."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import (
    AutoencoderConfig,
    TransformationConfig,
    TransformationTrainingConfig,
)
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.pairing import ALL, GaitClip, measure_gait, pair_by_gait
from pfnn_jax.transfer.run import (
    TransferRun,
    TransferRunConfig,
    create_transfer_run,
    load_transformation,
    save_transformation,
)
from pfnn_jax.transfer.transformation import TransformationNetwork, init_transformation
from pfnn_jax.transfer.transformation_training import apply_network, train_transformation
from tests.raising import assert_refused

ROUNDING = 1e-4  # relative to standard deviations: single precision, three convolutions and a projection
SIZES = AutoencoderConfig(filters=8, width=5)
SMALL = TransformationConfig(hidden=6, width=5)
TRAINING = TransformationTrainingConfig(network=SMALL, epochs=10, batch_size=2, held_out=0.3, steps_per_dispatch=4)


def walk(style: str = "neutral", frames: int = 130, speed: float = 1.2, turn: float = 0.0) -> np.ndarray:
    clip, _ = synthesise(style, np.full(frames, np.deg2rad(turn)), np.full(frames, speed), fps=60, seed=0)
    return encode_clip(clip, HOLDEN2017)


def make_run() -> TransferRun:
    """Returns a run that is on no disk, with random filters."""
    autoencoder, skeleton = init_autoencoder(SIZES, HOLDEN2017.size, key=jax.random.key(0)), synthetic_skeleton()
    config = TransferRunConfig(HOLDEN2017.name, SIZES, skeleton_to_json(skeleton))
    return TransferRun(
        Path("none"), config, HOLDEN2017, skeleton, fit_statistics(walk(), HOLDEN2017), autoencoder, "none"
    )


RUN = make_run()
CONTENTS = [GaitClip(walk(turn=turn), "walk", f"walk {turn}") for turn in (-30.0, 0.0, 30.0)]
STYLES = [GaitClip(walk("zombie"), "walk", "zombie")]


def network(seed: int = 0, config: TransformationConfig = SMALL) -> TransformationNetwork:
    return init_transformation(config, HOLDEN2017.size, key=jax.random.key(seed))


def test_the_network_has_three_layers_of_128_units_that_see_73_frames():
    made = network(config=TransformationConfig())
    assert [layer.filters.shape for layer in made.layers] == [(25, 66, 128), (25, 128, 128), (25, 128, 66)]
    assert made.receptive_field == 73


def test_a_frame_depends_on_the_receptive_field_alone():
    made, frames = network(), 60
    x = jax.random.normal(jax.random.key(1), (frames, HOLDEN2017.size))
    changed = np.flatnonzero(jnp.any(made(x.at[30].add(1.0)) != made(x), axis=1))
    half = made.receptive_field // 2
    assert changed.min() >= 30 - half and changed.max() <= 30 + half
    assert changed.max() - changed.min() > half  # and on more than one layer of it


def test_a_network_with_a_zero_last_layer_returns_the_mean():
    made = network()
    last = jax.tree.map(jnp.zeros_like, made.layers[2])
    made = made.replace(layers=(*made.layers[:2], last))  # type: ignore[attr-defined]
    found = apply_network(RUN, made, walk(), project=False)
    np.testing.assert_allclose(found, np.broadcast_to(RUN.statistics.mean, found.shape), atol=ROUNDING)


@pytest.mark.parametrize("project", [True, False])
@pytest.mark.parametrize("frames", [2, 31, 130])
def test_padding_does_not_change_the_result(project, frames):
    rows, made = walk()[:frames], network()
    even = np.concatenate([rows, rows[-1:]]) if frames % 2 else rows
    x = jnp.asarray(RUN.statistics.apply(even), jnp.float32)
    expected = RUN.autoencoder.project(made(x)) if project else made(x)
    found = apply_network(RUN, made, rows, project=project, keep_detail=False)
    np.testing.assert_allclose(found, RUN.statistics.invert(np.asarray(expected[:frames])), atol=ROUNDING)


def test_a_network_that_changes_nothing_returns_the_content_in_all_detail():
    class Identity:
        def __call__(self, x: jax.Array, mask: jax.Array) -> jax.Array:
            return x

    jax.tree_util.register_pytree_node(Identity, lambda _: ((), None), lambda *_: Identity())
    rows = walk()
    found = apply_network(RUN, Identity(), rows)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, rows, atol=ROUNDING)


def test_training_lowers_the_loss_on_clips_that_it_does_not_see():
    reports = []
    pairing = pair_by_gait(CONTENTS, STYLES, HOLDEN2017)
    made, metrics = train_transformation(RUN, CONTENTS, STYLES, pairing, TRAINING, progress_callback=reports.append)
    assert metrics["windows"] == 2 and metrics["held_out_windows"] == 1
    assert metrics["held_out"]["loss"] < 0.9 * metrics["held_out_before"]["loss"]
    assert reports[-1].step == reports[-1].steps == TRAINING.epochs
    assert np.isfinite(apply_network(RUN, made, walk())).all()


def test_equal_seeds_give_equal_networks():
    pairing = pair_by_gait(CONTENTS, STYLES, HOLDEN2017)
    trained = [train_transformation(RUN, CONTENTS, STYLES, pairing, TRAINING)[0] for _ in range(2)]
    jax.tree.map(np.testing.assert_array_equal, *trained)


def test_a_trained_style_is_stored_with_its_run(tmp_path):
    run = create_transfer_run(tmp_path / "run", RUN.layout, RUN.skeleton, RUN.statistics, RUN.autoencoder, {})
    save_transformation(run, "zombie", network(), {"clips": ["zombie.bvh"]})
    loaded = load_transformation(run, "zombie", jax.eval_shape(network))
    jax.tree.map(np.testing.assert_array_equal, loaded, network())


def test_training_needs_contents():
    pairing = pair_by_gait([], STYLES, HOLDEN2017)
    assert_refused(lambda: train_transformation(RUN, [], STYLES, pairing, TRAINING), place="contents", value="none")


def test_pairing_goes_by_labels_then_by_speed_then_takes_all():
    run_clip, standing = walk("zombie", speed=3.5), np.repeat(walk()[:1], 60, axis=0)
    standing[:, HOLDEN2017.root_velocity] = 0
    styles = [*STYLES, GaitClip(walk("zombie", turn=20.0), "walk-turn-left"), GaitClip(run_clip, "run")]
    contents = [
        GaitClip(walk(), "walk", "labelled"),
        GaitClip(walk(turn=20.0), "walk-turn-left", "turning"),
        GaitClip(walk(), "", "unlabelled"),
        GaitClip(walk(), "stroll", "other label"),
        GaitClip(walk(speed=3.5), "", "fast"),
        GaitClip(standing, "", "standing"),
    ]
    pairing = pair_by_gait(contents, styles, HOLDEN2017)
    groups = [pairing.groups[group] for group in pairing.group_of]
    assert groups == ["walk", "walk-turn-left", "gait walk", "gait walk", "gait run", ALL]
    members = dict(zip(pairing.groups, pairing.members, strict=True))
    assert members == {"walk": (0,), "walk-turn-left": (1,), "gait walk": (0, 1), "gait run": (2,), ALL: (0, 1, 2)}
    assert len(pairing.notes) == 4 and all(name in note for name, note in zip(
        ("unlabelled", "other label", "fast", "standing"), pairing.notes, strict=True))  # fmt: skip


def test_pairing_needs_a_style():
    assert_refused(lambda: pair_by_gait(CONTENTS, [], HOLDEN2017), place="styles", value="none")


@pytest.mark.parametrize(("speed", "gait"), [(0.0, "stand"), (1.2, "walk"), (3.5, "run")])
def test_gait_is_measured_by_speed(speed, gait):
    rows = np.array(walk(speed=max(speed, 1.0)))
    if speed == 0:
        rows[:, HOLDEN2017.root_velocity] = 0
    assert measure_gait(rows, HOLDEN2017) == gait
