"""The experiment on the weights of style transfer runs at a tiny size."""

from __future__ import annotations

import json

import jax
import numpy as np
import pytest

from experiments import transfer_weights
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import AutoencoderConfig, LossWeights, OptimisationConfig
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.run import create_transfer_run

SIZES = AutoencoderConfig(filters=8, width=5)
STYLES = {"normal": "neutral", "elderly": "zombie"}


@pytest.fixture
def data(tmp_path):
    """Returns a folder of procedural walks under names of Bandai-Namco-2, and a run with random filters."""
    folder = tmp_path / "data"
    folder.mkdir()
    for name, style in STYLES.items():
        for number in range(1, 5):
            clip, _ = synthesise(style, np.zeros(100), np.full(100, 1.0), fps=60, seed=number)
            write_bvh(folder / f"dataset-2_walk_{name}_{number:03}.bvh", clip)
    statistics = fit_statistics(encode_clip(clip, HOLDEN2017), HOLDEN2017)
    autoencoder = init_autoencoder(SIZES, HOLDEN2017.size, key=jax.random.key(0))
    create_transfer_run(tmp_path / "run", HOLDEN2017, synthetic_skeleton(), statistics, autoencoder, {})
    return folder


@pytest.mark.slow
def test_transfer_weights(data, tmp_path):
    config = transfer_weights.Config(data, tmp_path / "out", tmp_path / "run", contents=1, styles=1, epochs=1)
    still = OptimisationConfig(LossWeights(style=0.0), iterations=1, constraint_iterations=0)
    result = transfer_weights.main(config, {"nothing done": still})
    rows = result["rows"]
    assert list(rows) == ["content itself", "style clip itself", "nothing done"] and result["pairs"] == 1
    np.testing.assert_allclose(list(rows["nothing done"].values()), list(rows["content itself"].values()), atol=0.01)
    assert json.loads((tmp_path / "out" / "transfer_weights.json").read_text()) == result
    assert len((tmp_path / "out" / "transfer_weights.md").read_text().splitlines()) == 2 + 3


def test_the_mirror_exchanges_left_and_right():
    np.testing.assert_array_equal(transfer_weights.MIRROR[transfer_weights.MIRROR], np.arange(21))
