"""Small random runs for export."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import jax
import numpy as np

from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import layout_for
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.run import Run, create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig

HIDDEN = 12


def make_run(path: Path, name: str, kind: str, num_styles: int = 2) -> Run:
    """Creates a run with a small random network and styles on the procedural skeleton; its rollouts stay bounded."""
    skeleton, generator = synthetic_skeleton(), np.random.default_rng(7)
    layout = layout_for(name, skeleton)
    gated = {"phase_size": layout.phase_size, "gating_hidden": 5} if layout.phase_size else {}
    network = NetworkConfig(layout.input_size, layout.output_size, HIDDEN, 4, **gated)
    names = tuple(f"style{index}" for index in range(num_styles))
    adapter = AdapterConfig(cast(AdapterKind, kind), 3)
    config = RunConfig(network, adapter, name, layout.num_joints, names, skeleton_to_json(skeleton))
    sizes = [layout.input_size, layout.output_size] + [layout.phase_size] * bool(layout.phase_size)
    sides = [Statistics(*(generator.uniform(0.2, 0.8, (2, size)).astype(np.float32))) for size in sizes]
    create_run(path, config, Normaliser(*sides))
    save_shared(path, init_network(network, key=jax.random.key(1)))
    for index, style in enumerate(names):
        parameters = init_style(adapter, network, key=jax.random.key(10 + index))
        noise = [0.1 * generator.normal(size=leaf.shape) for leaf in jax.tree.leaves(parameters)]
        noise = jax.tree.unflatten(jax.tree.structure(parameters), noise)
        parameters = jax.tree.map(lambda leaf, more: (leaf + more).astype(np.float32), parameters, noise)
        save_style(path, style, parameters, {"speed": 1.0 + 0.1 * index})
    return load_run(path)
