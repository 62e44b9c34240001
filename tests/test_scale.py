"""What a training step costs, as docs/scale.md states it."""

from __future__ import annotations

import pytest

from experiments.scale import costs_of, summed_bytes
from pfnn_jax.benchmarks.training import flops, products
from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.presets import counts

BATCH = 32
FIRST_LAYER = 0.1  # share of the operations: the gradient of the first layer's input is counted, which nobody needs

PROGRAM = """
  %sum.1 = (f32[4,8]{1,0}, f32[]) all-reduce(%a, %b), replica_groups={{0,1}}, to_apply=%add
  %sum.2 = f32[16]{0} all-reduce-start(%c), to_apply=%add
  %other = f32[100]{0} add(%d, %e)
"""


def test_parameters_are_those_of_the_papers():
    pfnn, lpn = costs_of("pfnn", 8, 512, BATCH), costs_of("lpn", 95, 512, BATCH)
    assert pfnn.gradient_bytes == 4 * pfnn.trained
    assert pfnn.kept - pfnn.trained == 7 * 31_352  # Mason 2022 Table 2: parameters of one style with CP adapters
    found = counts("lpn_film")
    assert lpn.trained == lpn.kept == found.synthesis + found.modulation


def test_operations_are_those_of_the_products():
    sizes = NetworkConfig(234, 400, hidden=512)
    frame = flops(products(sizes, 30, BATCH)) / BATCH
    assert frame <= costs_of("pfnn", 8, 512, BATCH).operations <= (1 + FIRST_LAYER) * frame


def test_more_styles_of_a_bank_cost_memory_alone():
    few, many = (costs_of("pfnn", count, 64, BATCH) for count in (8, 80))
    assert many.state_bytes > few.state_bytes
    assert (many.trained, many.operations, many.gradient_bytes) == (few.trained, few.operations, few.gradient_bytes)


def test_sums_over_devices_are_found_in_a_program():
    assert summed_bytes(PROGRAM) == pytest.approx(4 * (32 + 1 + 16))
