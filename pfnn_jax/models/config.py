"""Configurations of networks, styles and FiLM generators. Importing this file does not import JAX."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal, TypeAlias

from pfnn_jax.errors import check_at_least
from pfnn_jax.models.layers import style_kinds

POOLING = 4
"""Factor by which the FiLM generator reduces the number of frames: it pools twice, two frames into one."""

if TYPE_CHECKING:
    AdapterKind: TypeAlias = str
else:
    AdapterKind = Literal[style_kinds()]  # the command line lists these as choices


CP_KINDS = ("cp", "cp_output")
"""Kinds of style that have a rank."""


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of a network.

    Attributes:
        input_size, output_size: numbers of one frame.
        hidden: H, width of both hidden layers.
        num_control_points: K, control points of the phase spline or experts of the gating network.
        rank: None for full blended layers; a number makes every layer a CP decomposition of that rank
            (mentioned in Mason 2018 §7.1).
        phase_size: 0 where the coefficients are a spline of a scalar phase; otherwise the inputs of a gating network.
        gating_hidden: width of both hidden layers of the gating network.
    """

    input_size: int
    output_size: int
    hidden: int = 512
    num_control_points: int = 4
    rank: int | None = None
    phase_size: int = 0
    gating_hidden: int = 32

    def __post_init__(self):
        check_at_least(self, "input_size", "output_size", "hidden", "rank", "gating_hidden")
        check_at_least(self, "phase_size", least=0)
        check_at_least(self, "num_control_points", least=4 if self.phase_size == 0 else 1)


@dataclass(frozen=True)
class AdapterConfig:
    """The form of a style.

    Attributes:
        kind: a residual on the second layer, namely `cp` (Mason 2018 Eq. 6), `full` (a blended matrix), `diagonal`,
            `bias` (a blended bias alone) or `dense` (a matrix that is not blended, Mason 2022 §5.2.1); or `one_hot`
            (a blended shift of the first layer); or `film` (scales and shifts of both hidden layers, Mason 2022 Eq. 3);
            or `cp_output`, a `cp` residual on the third layer.
        rank: R of the CP factors; the other kinds ignore it.
    """

    kind: AdapterKind = "cp"
    rank: int = 30

    def __post_init__(self):
        kinds = style_kinds()
        if self.kind not in kinds:
            rule = ", ".join(kinds[:-1]) + f" or {kinds[-1]}"
            raise ValueError(f"AdapterConfig.kind must be {rule}, got {self.kind!r}.")
        check_at_least(self, "rank")


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes of a FiLM generator.

    Attributes:
        features: F, numbers of one frame of the clip: 12 for every joint, without the trajectory.
        clip_frames: T, frames of a clip, a multiple of 4.
        filters: channels of both convolutions.
        width: frames that a filter spans.
        hidden: width of the first dense layer.
        film_hidden: H of the network that is modulated; the last layer has 4H outputs.
    """

    features: int
    clip_frames: int = 240
    filters: int = 256
    width: int = 25
    hidden: int = 2048
    film_hidden: int = 512

    def __post_init__(self):
        check_at_least(self, *(field.name for field in fields(self)))
        if self.clip_frames % POOLING:
            raise ValueError(f"GeneratorConfig.clip_frames must be a multiple of {POOLING}, got {self.clip_frames}.")
