"""RUN/config.json: everything needed to rebuild a run."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax

from pfnn_jax.errors import InputError
from pfnn_jax.models.adapters import AdapterConfig
from pfnn_jax.models.film_generator import GeneratorConfig
from pfnn_jax.models.network import NetworkConfig
from pfnn_jax.motion.layout import LAYOUTS
from pfnn_jax.training.checkpoint import locate, read_json

RUN_RULE = "must be a run directory, as `pfnn-jax pretrain` or `pfnn-jax import-released` writes it"


def _versions() -> dict[str, str]:
    return {"pfnn_jax": importlib.metadata.version("pfnn-jax"), "jax": jax.__version__}


@dataclass(frozen=True)
class RunConfig:
    """Everything needed to rebuild a run.

    Attributes:
        network: sizes of the shared network.
        adapter: form of the styles that pretraining learned. A later style may be an adapter of another kind, but
            Films and adapters do not stand beside one network: it was trained with layer norms, or without.
        layout: name of the frame layout.
        num_joints: J.
        styles: names of the pretraining styles, in the order of the adapter bank.
        skeleton: as `skeleton_to_json` returns it.
        pretrain: settings of pretraining, or where the parameters came from.
        generator: sizes of the FiLM generator in RUN/generator/, or None where there is none.
        command_gain: what commanded speeds are multiplied by before they reach the network.
        versions: of pfnn_jax and jax at the time of writing.
    """

    network: NetworkConfig
    adapter: AdapterConfig
    layout: str
    num_joints: int
    styles: tuple[str, ...]
    skeleton: Mapping[str, Any]
    pretrain: Mapping[str, Any] = field(default_factory=dict)
    generator: GeneratorConfig | None = None
    command_gain: float = 1.0
    versions: Mapping[str, str] = field(default_factory=_versions)

    def __post_init__(self):
        if self.layout not in LAYOUTS:
            raise ValueError(f"RunConfig.layout must be one of {', '.join(LAYOUTS)}, got {self.layout!r}.")
        layout = LAYOUTS[self.layout](self.num_joints)
        if self.network.phase_size != layout.phase_size:
            raise ValueError(
                f"RunConfig.network must have phase_size {layout.phase_size} for layout {self.layout}, "
                f"got {self.network.phase_size}."
            )
        if self.command_gain <= 0:
            raise ValueError(f"RunConfig.command_gain must be positive, got {self.command_gain}.")
        sizes = (self.network.input_size, self.network.output_size)
        if sizes != (layout.input_size, layout.output_size):
            raise ValueError(
                f"RunConfig.network must have {layout.input_size} inputs and {layout.output_size} outputs "
                f"for layout {self.layout} with {self.num_joints} joints, got {sizes[0]} and {sizes[1]}."
            )


def load_config(path: str | Path) -> RunConfig:
    """Reads RUN/config.json; the shared parameters need not exist yet.

    Raises:
        InputError: if it is absent or malformed, or a value breaks a rule.
    """
    file = (locate(Path(path)) or Path(path)) / "config.json"
    data = read_json(file, RUN_RULE)
    try:
        network, adapter = NetworkConfig(**data.pop("network")), AdapterConfig(**data.pop("adapter"))
        sizes = data.pop("generator", None)
        generator = None if sizes is None else GeneratorConfig(**sizes)
        styles = tuple(data.pop("styles"))
        return RunConfig(network=network, adapter=adapter, styles=styles, generator=generator, **data)
    except KeyError as error:
        raise InputError(file, "entry", f"{error.args[0]} is absent", RUN_RULE) from error
    except (TypeError, ValueError) as error:
        raise InputError(file, "entries", str(error).removesuffix("."), RUN_RULE) from error
