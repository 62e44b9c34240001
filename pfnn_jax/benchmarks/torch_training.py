"""Benchmark of the training step compared with PyTorch, which the package itself never uses (extra `compare`)."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.benchmarks.timing import Figure, Work, figure, interleave
from pfnn_jax.benchmarks.training import (
    FRAMES,
    L1,
    LEARNING_RATE,
    RATE,
    STYLES,
    fresh_state,
    random_frames,
    stepper,
)
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.training.data import Batch
from pfnn_jax.training.loop import TrainState
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.steps import equal_dropout, make_pretrain_step, predict_batch

OUTPUTS = 1e-4
"""Largest difference of normalised outputs, which are near 1: sums of 2,048 products in float32."""


class TorchTraining:
    """A PFNN with a bank of CP adapters in eager PyTorch, trained by fused Adam.

    It computes the same function with the same products as the package: one for each layer, over the flattened c ⊗ x.
    Like there, a step changes the shared network and one style.

    Args:
        state: whose parameters are copied; a bank of CP adapters.
    """

    def __init__(self, state: TrainState):
        self.torch: Any = import_module("torch")
        network, bank = state.params.shared, state.params.modulation
        self.layers = [[self._parameter(leaf) for leaf in (layer.weights, layer.biases)] for layer in network.layers]
        leaves = [bank.a, bank.b, bank.d, bank.bias]
        self.bank = [[self._parameter(leaf[style]) for leaf in leaves] for style in range(len(bank.a))]
        self.shared = [leaf for layer in self.layers for leaf in layer]
        adam = self.torch.optim.Adam
        self.shared_tx = adam(self.shared, LEARNING_RATE, fused=True)
        self.style_txs = [adam(style, LEARNING_RATE, fused=True) for style in self.bank]

    def _parameter(self, leaf: Any) -> Any:
        return self.torch.nn.Parameter(self.torch.tensor(np.array(leaf)))

    def outputs(self, style: int, x: Any, phase: Any, rate: float) -> Any:
        """Returns normalised outputs [B, O] of tensors x [B, I] and phase [B], with dropout at a rate."""
        functional, c = self.torch.nn.functional, self._coefficients(phase)
        a, b, d, bias = self.bank[style]

        def blended(index: int, value: Any) -> Any:
            weights, biases = self.layers[index]
            scaled = (c[:, :, None] * functional.dropout(value, rate)[:, None, :]).flatten(1)
            return self.torch.addmm(c @ biases, scaled, weights.flatten(0, 1))

        hidden = functional.elu(blended(0, x))
        adapter = ((functional.dropout(hidden, rate) @ b) * (c @ d)) @ a.T + bias
        return blended(2, functional.elu(blended(1, hidden) + adapter))

    def step(self, style: int, x: Any, y: Any, phase: Any) -> Any:
        """Takes a step on tensors of one style's frames; returns the squared error []."""
        self.shared_tx.zero_grad()
        self.style_txs[style].zero_grad()
        error = self.torch.nn.functional.mse_loss(self.outputs(style, x, phase, RATE), y)
        (error + L1 * (self._penalty(self.shared) + self._penalty(self.bank[style]))).backward()
        self.shared_tx.step()
        self.style_txs[style].step()
        return error.detach()

    def _penalty(self, leaves: list[Any]) -> Any:
        return self.torch.stack([leaf.abs().mean() for leaf in leaves]).mean()

    def _coefficients(self, phase: Any) -> Any:
        """Returns the coefficients [B, K] of the phase spline; the form of `models/spline.py`."""
        count = self.layers[0][0].shape[0]
        offset = phase[:, None] * (count / (2 * math.pi)) - self.torch.arange(count)
        d = (offset - count * (offset / count + 0.5).floor()).abs()
        near, far = (1 - d) * (1 + d - 1.5 * d * d), -0.5 * (d - 1) * (d - 2) ** 2
        return self.torch.where(d < 1, near, self.torch.where(d < 2, far, 0.0))


def check_outputs(training: TorchTraining, state: TrainState, batch: Batch) -> None:
    """Checks that both compute the same outputs in style 0.

    Raises:
        AssertionError: where they differ by more than `OUTPUTS`.
    """
    style = jax.tree.map(lambda leaf: leaf[0], state.params.modulation)
    ours = predict_batch(state.params.shared, style, batch, None, None)
    x, phase = (training.torch.tensor(np.array(leaf)) for leaf in (batch.x, batch.phase))
    with training.torch.no_grad():
        theirs = training.outputs(0, x, phase, 0.0)
    np.testing.assert_allclose(theirs.numpy(), ours, atol=OUTPUTS)


def torch_stepper(training: TorchTraining, data: Batch, batch_size: int, num_steps: int) -> Work:
    """Returns the work of `num_steps` steps on data [S, N, ...], as `stepper` returns that of the package."""
    torch, (styles, frames) = training.torch, data.phase.shape[:2]
    x, y, phase = (torch.tensor(np.array(leaf)) for leaf in (data.x, data.y, data.phase))
    picks = torch.tensor(np.random.default_rng(0).integers(0, frames, (num_steps, batch_size)))

    def work() -> float:
        error = torch.zeros(())
        for number, rows in enumerate(picks):
            style = number % styles
            error = training.step(style, x[style, rows], y[style, rows], phase[style, rows])
        return float(error)

    return work


def torch_step_figures(
    sizes: NetworkConfig, rank: int, batch_size: int, repetitions: int, num_steps: int
) -> list[Figure]:
    """Compares a training step of a PFNN with CP adapters to the same step in PyTorch."""
    section = f"training step in PyTorch, batch {batch_size}"
    data, state = random_frames((STYLES, FRAMES), sizes), fresh_state(sizes, AdapterConfig("cp", rank))
    training = TorchTraining(state)
    check_outputs(training, state, jax.tree.map(lambda leaf: jnp.asarray(leaf[0, :batch_size]), data))
    step = make_pretrain_step(optax.adam(LEARNING_RATE), Objective(L1), equal_dropout(RATE))
    works = {
        "ours": stepper(step, state, data, batch_size, num_steps),
        "PyTorch": torch_stepper(training, data, batch_size, num_steps),
    }
    seconds = interleave(works, repetitions)
    ours, theirs = seconds["ours"] / num_steps, seconds["PyTorch"] / num_steps
    return [
        figure(section, "step", 1e3 * ours, "ms"),
        figure(section, f"step in PyTorch {training.torch.__version__}", 1e3 * theirs, "ms"),
        figure(section, "times faster", theirs / ours, "x"),
    ]
