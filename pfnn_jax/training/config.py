"""How a network is pretrained: the settings, and the sizes that follow from a layout."""

from __future__ import annotations

from dataclasses import dataclass, field

import jax.numpy as jnp

from pfnn_jax.models.config import AdapterConfig, GeneratorConfig, NetworkConfig
from pfnn_jax.models.dropout import Dropout
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.training.data import CLIP_FRAMES, Rows, num_clip_columns
from pfnn_jax.training.losses import PenaltyNorm
from pfnn_jax.training.steps import Objective, bones_of

SPLINE_POINTS, EXPERTS = 4, 8
"""Control points of a phase spline (both papers), and experts behind a gating network (Mason 2022 §4.3)."""

L1 = 0.01
"""λ of Mason 2018 Eq. 3, used with the layouts of 2017 and 2018."""

BONE_LENGTH = 1.0
"""Weight of the bone-length loss, used with the layouts of 2022 (§4.4 adds it without a weight)."""


@dataclass(frozen=True)
class PretrainConfig:
    """How the shared network is trained.

    Attributes:
        adapter: form of every style; `film` trains a generator that reads clips.
        hidden: H, width of both hidden layers.
        num_control_points: K; by default 4 points of a phase spline or 8 experts, as the layout needs.
        gating_hidden: width of the gating network, where the layout needs one.
        rank: None, or the rank to which every layer is CP-decomposed (Mason 2018 §7.1's aside).
        clips_per_batch: clips that a FiLM generator reads for a minibatch, each modulating an equal share of its
            frames. The authors' code reads one for each frame, 32, at some 30 times the price.
        generator_filters, generator_width, generator_hidden: sizes of the FiLM generator.
        epochs: passes over the shortest style (2018: 25; 2022: 90).
        steps: number of steps; overrides `epochs` where set.
        batch_size: frames of one minibatch, all of one style.
        learning_rate: Adam's (1e-4 in the authors' code).
        dropout: drop probability before every layer and adapter, and in the gating network and the generator.
        l1: λ of Mason 2018 Eq. 3; by default 0.01, or 0 with the layouts of 2022.
        l1_norm: mean of |W| over each array, as the authors' code, or sum, as the paper writes it.
        bone_length: weight of the bone-length loss; by default 0, or 1 with the layouts of 2022.
        seed: of initialisation, shuffling and dropout.
        steps_per_dispatch: steps compiled into one call, and the grain of metrics.
        save_every: steps between saves of the training state.
        device_bytes: data larger than this stays on disk and is sent batch by batch.
    """

    adapter: AdapterConfig = field(default_factory=AdapterConfig)
    hidden: int = 512
    num_control_points: int | None = None
    gating_hidden: int = 32
    rank: int | None = None
    clips_per_batch: int = 4
    generator_filters: int = 256
    generator_width: int = 25
    generator_hidden: int = 2048
    epochs: int = 25
    steps: int | None = None
    batch_size: int = 32
    learning_rate: float = 1e-4
    dropout: float = 0.3
    l1: float | None = None
    l1_norm: PenaltyNorm = "mean"
    bone_length: float | None = None
    seed: int = 0
    steps_per_dispatch: int = 100
    save_every: int = 1000
    device_bytes: int = 2**32

    def __post_init__(self):
        for name in ("epochs", "batch_size", "steps_per_dispatch", "save_every", "clips_per_batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"PretrainConfig.{name} must be at least 1, got {getattr(self, name)}.")
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"PretrainConfig.steps must be at least 1, got {self.steps}.")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"PretrainConfig.dropout must be in [0, 1), got {self.dropout}.")
        if self.learning_rate <= 0:
            raise ValueError(f"PretrainConfig.learning_rate must be positive, got {self.learning_rate}.")
        for name in ("l1", "bone_length", "seed"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise ValueError(f"PretrainConfig.{name} must not be negative, got {value}.")
        # a size that no layout could have; `network` and `generator` hold those for a layout to the same rules
        NetworkConfig(1, 1, self.hidden, self._points(1), self.rank, phase_size=1, gating_hidden=self.gating_hidden)
        self._generator(1)
        if self.adapter.kind == "film" and self.batch_size % self.clips_per_batch:
            raise ValueError(
                f"PretrainConfig.clips_per_batch must divide batch_size {self.batch_size}, got {self.clips_per_batch}."
            )

    @property
    def num_clips(self) -> int:
        """C clips read for a minibatch; 0 where styles do not come from a generator."""
        return self.clips_per_batch if self.adapter.kind == "film" else 0

    def network(self, layout: FrameLayout) -> NetworkConfig:
        """The sizes of the network for a layout's frames.

        Raises:
            ValueError: for fewer control points than the spline of the layout's phase needs.
        """
        return NetworkConfig(
            layout.input_size,
            layout.output_size,
            self.hidden,
            self._points(layout.phase_size),
            self.rank,
            phase_size=layout.phase_size,
            gating_hidden=self.gating_hidden,
        )

    def generator(self, layout: FrameLayout) -> GeneratorConfig | None:
        """The sizes of the FiLM generator for a layout's joints, or None where the adapter is no Film."""
        return self._generator(num_clip_columns(layout)) if self.adapter.kind == "film" else None

    def _points(self, phase_size: int) -> int:
        if self.num_control_points is None:
            return EXPERTS if phase_size else SPLINE_POINTS
        return self.num_control_points

    def _generator(self, features: int) -> GeneratorConfig:
        return GeneratorConfig(
            features=features,
            clip_frames=CLIP_FRAMES,
            filters=self.generator_filters,
            width=self.generator_width,
            hidden=self.generator_hidden,
            film_hidden=self.hidden,
        )

    def objective(self, data: Rows) -> Objective:
        """The loss on this data, with the layout's defaults."""
        return make_objective(data, self.l1, self.l1_norm, self.bone_length)


def make_objective(
    data: Rows, l1: float | None = None, l1_norm: PenaltyNorm = "mean", bone_length: float | None = None
) -> Objective:
    """The loss on `data`; that of the layout's paper where `l1` and `bone_length` are None."""
    of_2022 = data.layout.next_frame
    l1 = (0.0 if of_2022 else L1) if l1 is None else l1
    bone_length = (BONE_LENGTH if of_2022 else 0.0) if bone_length is None else bone_length
    return Objective(l1, l1_norm, bone_length, bones_of(data) if bone_length else None)


def equal_dropout(rate: float) -> Dropout:
    """One drop probability everywhere."""
    return Dropout(main=jnp.float32(rate), adapter=jnp.float32(rate))
