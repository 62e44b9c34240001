"""The seven models of Mason 2022 Table 2: three synthesis networks and four forms of style."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax

from pfnn_jax.models.config import POOLING, AdapterConfig, GeneratorConfig, NetworkConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import init_network, num_parameters
from pfnn_jax.models.style import init_style

Backbone = Literal["pfnn", "mann", "lpn"]

# Frame layout of each synthesis network.
LAYOUT_OF: dict[Backbone, str] = {"pfnn": "mason2022_pfnn", "mann": "mason2022_mann", "lpn": "mason2022"}

JOINTS, HIDDEN = 25, 512  # the paper's character and networks


class _Sizes(NamedTuple):
    other_outputs: int  # outputs besides trajectory and pose
    phase_size: int
    num_control_points: int


_SIZES: dict[Backbone, _Sizes] = {
    "pfnn": _Sizes(other_outputs=3, phase_size=0, num_control_points=4),  # two contacts, the phase update
    "mann": _Sizes(other_outputs=2, phase_size=12, num_control_points=8),  # two contacts
    "lpn": _Sizes(other_outputs=18, phase_size=8, num_control_points=8),  # phases, their updates, two contacts
}


@dataclass(frozen=True)
class Preset:
    """One model: a synthesis network and the form of its styles."""

    backbone: Backbone
    adapter: AdapterConfig


TABLE2: dict[str, Preset] = {
    "pfnn_one_hot": Preset("pfnn", AdapterConfig("one_hot")),
    "lpn_one_hot": Preset("lpn", AdapterConfig("one_hot")),
    "pfnn_resad": Preset("pfnn", AdapterConfig("cp", rank=30)),
    "lpn_resad": Preset("lpn", AdapterConfig("dense")),
    "pfnn_film": Preset("pfnn", AdapterConfig("film")),
    "mann_film": Preset("mann", AdapterConfig("film")),
    "lpn_film": Preset("lpn", AdapterConfig("film")),
}


@dataclass(frozen=True)
class Counts:
    """Numbers of parameters, the columns of Mason 2022 Table 2.

    Attributes:
        synthesis: of the synthesis network, including its gating network.
        modulation: of all styles together, or of the FiLM generator.
        per_style: of one style at run time.
        modulation_published: as printed in the paper, which differs for the FiLM generator only.
    """

    synthesis: int
    modulation: int
    per_style: int
    modulation_published: int


def network_config(backbone: Backbone, num_joints: int = JOINTS, hidden: int = HIDDEN) -> NetworkConfig:
    """Returns the sizes of a synthesis network for a character of `num_joints` joints (Mason 2022 §4.3).

    Raises:
        ValueError: for an unknown backbone.
    """
    if backbone not in _SIZES:
        raise ValueError(f"`backbone` must be pfnn, mann or lpn, got {backbone!r}.")
    sizes = _SIZES[backbone]
    return NetworkConfig(
        input_size=48 + 12 * num_joints,
        output_size=24 + 12 * num_joints + sizes.other_outputs,
        hidden=hidden,
        num_control_points=sizes.num_control_points,
        phase_size=sizes.phase_size,
    )


def counts(name: str, num_styles: int = 95) -> Counts:
    """Counts the parameters of a model of `TABLE2` for the paper's character, in the records themselves.

    Raises:
        ValueError: for an unknown name.
    """
    if name not in TABLE2:
        raise ValueError(f"`name` must be one of {', '.join(TABLE2)}, got {name!r}.")
    preset, key = TABLE2[name], jax.random.key(0)
    config = network_config(preset.backbone)
    synthesis = _count(lambda: init_network(config, key=key))
    per_style = _count(lambda: init_style(preset.adapter, config, key=key))
    if preset.adapter.kind != "film":
        return Counts(synthesis, num_styles * per_style, per_style, num_styles * per_style)
    generator = GeneratorConfig(features=12 * JOINTS, film_hidden=HIDDEN)
    modulation = _count(lambda: FiLMGenerator.init(generator, key=key))
    return Counts(synthesis, modulation, per_style, paper_count(generator))


def paper_count(config: GeneratorConfig) -> int:
    """Returns the generator's number of parameters as Mason 2022 Table 2 counts it.

    The paper counts `filters · width + width` for each of the two convolutions; a convolution has `inputs · filters ·
    width + filters`. The dense layers are counted in full.
    """
    flat, outputs = config.clip_frames // POOLING * config.filters, 4 * config.film_hidden
    dense = (flat + 1) * config.hidden + (config.hidden + 1) * outputs
    return 2 * (config.filters * config.width + config.width) + dense


def _count(make) -> int:
    return num_parameters(jax.eval_shape(make))
