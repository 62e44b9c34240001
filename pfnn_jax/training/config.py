"""The settings of pretraining, few-shot learning and generator tuning, and the sizes that follow from a layout."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

from pfnn_jax.errors import (
    check_at_least,
    check_field,
    check_not_negative,
    check_one_of,
    check_positive,
    check_probability,
)
from pfnn_jax.models.config import AdapterConfig, GeneratorConfig, NetworkConfig
from pfnn_jax.models.layers import style_kinds
from pfnn_jax.motion.datasets.splits import WINDOW_ROWS
from pfnn_jax.motion.features.layout import FrameLayout

SPLINE_POINTS, EXPERTS = 4, 8
"""Control points of a phase spline (both papers), and experts behind a gating network (Mason 2022 §4.3)."""

PenaltyNorm = Literal["mean", "sum"]

Precision = Literal["float32", "tf32", "bfloat16"]
"""Of the factors of matrix products; sums are float32."""

METHODS = (*style_kinds(), "fine_tune", "scratch")
"""Every kind of style, and training of all weights from the shared network's or from random ones."""

if TYPE_CHECKING:
    Method: TypeAlias = str
else:
    Method = Literal[METHODS]  # the command line lists these as choices


@dataclass(frozen=True)
class PretrainConfig:
    """How the shared network is trained.

    Attributes:
        adapter: form of every style; `film` trains a generator that predicts FiLM parameters from clips.
        hidden: H, width of both hidden layers.
        num_control_points: K; by default 4 points of a phase spline or 8 experts, as the layout needs.
        gating_hidden: width of the gating network, where the layout needs one.
        rank: None, or the rank to which every layer is CP-decomposed (mentioned in Mason 2018 §7.1).
        clips_per_batch: clips that a FiLM generator reads for a minibatch, each modulating an equal share of its
            frames. The authors' code reads one for each frame, 32, at about 30 times the cost.
        generator_filters, generator_width, generator_hidden: sizes of the FiLM generator.
        epochs: passes over the shortest style (2018: 25; 2022: 90).
        steps: number of steps; overrides `epochs` where set.
        batch_size: frames of one minibatch, all of one style.
        learning_rate: of Adam (1e-4 in the authors' code).
        dropout: drop probability before every layer and adapter, and in the gating network and the generator;
            rounded to 1/256.
        pose_noise: standard deviation of noise on the normalised joint inputs, of which each frame takes a random
            share: a network that has seen disturbed poses returns to its walk instead of leaving it. By default 0.05,
            half of the inputs' own deviation under grouped statistics, or 0 where the layout has local phases.
        l1: λ of Mason 2018 Eq. 3; by default 0.01, or 0 with the layouts of 2022.
        l1_norm: mean of |W| over each array, as the authors' code, or sum, as the paper writes it.
        bone_length: weight of the bone-length loss; by default 0, or 1 with the layouts of 2022.
        seed: of initialisation, shuffling and dropout.
        precision: of matrix products on GPUs and TPUs; CPUs compute all of them in float32 (docs/scale.md).
        steps_per_dispatch: steps that are compiled into one call, and between two lines of metrics.
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
    pose_noise: float | None = None
    l1: float | None = None
    l1_norm: PenaltyNorm = "mean"
    bone_length: float | None = None
    seed: int = 0
    precision: Precision = "float32"
    steps_per_dispatch: int = 100
    save_every: int = 1000
    device_bytes: int = 2**32

    def __post_init__(self):
        check_at_least(self, "epochs", "batch_size", "steps_per_dispatch", "save_every", "clips_per_batch", "steps")
        check_probability(self, "dropout")
        check_positive(self, "learning_rate")
        check_not_negative(self, "pose_noise", "l1", "bone_length", "seed")
        check_one_of(self, "l1_norm", get_args(PenaltyNorm))
        check_one_of(self, "precision", get_args(Precision))
        # Sizes that no layout could have; `network` and `generator` check those for one layout by the same rules.
        NetworkConfig(1, 1, self.hidden, self._points(1), self.rank, phase_size=1, gating_hidden=self.gating_hidden)
        self._generator(1)
        if self.adapter.kind == "film":
            _check_shares(self)

    @property
    def num_clips(self) -> int:
        """C clips read for a minibatch; 0 where styles do not come from a generator."""
        return self.clips_per_batch if self.adapter.kind == "film" else 0

    def network(self, layout: FrameLayout) -> NetworkConfig:
        """Returns the sizes of the network for a layout's frames.

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
        """Returns the sizes of the FiLM generator for a layout's joints, or None where the adapter is not FiLM."""
        return self._generator(num_clip_columns(layout)) if self.adapter.kind == "film" else None

    def _points(self, phase_size: int) -> int:
        if self.num_control_points is None:
            return EXPERTS if phase_size else SPLINE_POINTS
        return self.num_control_points

    def _generator(self, features: int) -> GeneratorConfig:
        return GeneratorConfig(
            features=features,
            clip_frames=WINDOW_ROWS,
            filters=self.generator_filters,
            width=self.generator_width,
            hidden=self.generator_hidden,
            film_hidden=self.hidden,
        )


def _are_increasing(epochs: tuple[int, ...]) -> bool:
    return bool(epochs) and list(epochs) == sorted(set(epochs)) and epochs[0] >= 1


@dataclass(frozen=True)
class FewShotConfig:
    """How a style is learned from a clip: by default as in Mason 2018 §7.2.

    Every combination of rates is one setting of a grid; all are trained at once by `vmap`, each is evaluated after
    every number of epochs in `eval_epochs`, and one (setting, number of epochs) is chosen. Their recipe is a grid over
    the rates of adapter dropout alone. What a run learns with is chosen by `pfnn_jax.workflows.learn.default_config`.

    Attributes:
        method: `cp`, `full`, `diagonal`, `bias` or `dense` adapters; `cp_output`, a CP adapter of the last layer;
            `one_hot`, a shift of the first layer; `film`, the 4H parameters of a FiLM style, for a network trained with
            FiLM; `fine_tune` (all shared weights, from the pretrained ones) and `scratch` (all weights, from a fresh
            network) are the baselines of §8.1.
        rank: R of a CP adapter.
        learning_rates: of Adam, to try.
        main_dropouts: drop probabilities before the shared layers to try, rounded to 1/256.
        adapter_dropouts: drop probabilities before the adapter to try (the variable dropout of §7.2).
        eval_epochs: numbers of epochs after which candidates are kept, increasing; training ends after the last.
        decay: whether the learning rates fall to zero along half a cosine; takes one number of epochs.
        restyled: whether to learn also from rows of the known styles, restyled (`pfnn_jax.training.restyling`).
        batch_size: frames of a minibatch.
        l1: λ of Eq. 3 on what is trained; FiLM parameters are not penalised: their identity is scale 1, not 0.
        bone_length: weight of the bone-length loss, where the rows' bones are known.
        held_out: share of the clip's frames, at its end, that choose among the settings.
        tolerance: how much larger than the best a setting's held-out error may be; of those within it that remove at
            least half as much error as the best, the most conservative is taken (least learning rate times epochs).
            0 takes the best. Where rates and epochs differ, the frames of a straight walk favour settings that fit
            straight walks.
        seed: of initialisation, shuffling and dropout.
        precision: of matrix products on GPUs and TPUs.
    """

    method: Method = "cp"
    rank: int = 30
    learning_rates: tuple[float, ...] = (1e-4,)
    main_dropouts: tuple[float, ...] = (0.3,)
    adapter_dropouts: tuple[float, ...] = (0.3, 0.5, 0.7)
    eval_epochs: tuple[int, ...] = (100,)
    decay: bool = False
    restyled: bool = False
    batch_size: int = 32
    l1: float = 0.01
    bone_length: float = 1.0
    held_out: float = 0.2
    tolerance: float = 0.0
    seed: int = 0
    precision: Precision = "float32"

    def __post_init__(self):
        check_one_of(self, "method", METHODS)
        check_one_of(self, "precision", get_args(Precision))
        check_at_least(self, "rank", "batch_size")
        check_field(self, "eval_epochs", "be increasing whole numbers from 1", _are_increasing)
        if self.decay:
            check_field(self, "eval_epochs", "be one number where the rates decay", lambda epochs: len(epochs) == 1)
        check_field(self, "held_out", "lie between 0 and 1", lambda share: 0 < share < 1)
        check_not_negative(self, "tolerance", "l1", "bone_length")
        for name in ("main_dropouts", "adapter_dropouts"):
            check_field(self, name, "be rates in [0, 1)", lambda rates: rates and all(0 <= rate < 1 for rate in rates))
        check_field(self, "learning_rates", "be positive", lambda rates: rates and all(rate > 0 for rate in rates))


MASON2018_FEW_SHOT = FewShotConfig()
"""Mason 2018 §7.2: CP of rank 30, 100 epochs at 1e-4, a grid over the authors' rates of adapter dropout alone."""

RESTYLED_FEW_SHOT = FewShotConfig(
    method="cp_output",
    learning_rates=(5e-3,),
    main_dropouts=(0.3,),
    adapter_dropouts=(0.0,),
    eval_epochs=(35,),
    decay=True,
    restyled=True,
    batch_size=128,
)
"""The clip and the known styles' turns in the new style: about 600 steps (docs/research/few_shot.md)."""

FILM_FEW_SHOT = FewShotConfig(
    method="film",
    learning_rates=(1e-4, 1e-3, 3e-3),
    main_dropouts=(0.0,),
    adapter_dropouts=(0.0,),  # FiLM parameters have no dropout of their own
    eval_epochs=(5, 10, 25, 50, 100),
    tolerance=0.5,
)
"""For a network trained with FiLM: the 4H parameters of a FiLM style, at rates that move them in a few epochs, and the
most conservative of those that fit the clip."""


@dataclass(frozen=True)
class TuningConfig:
    """How a FiLM generator is tuned to a style (Mason 2022 §4.5).

    Attributes:
        epochs: passes over the style's frames (100 in the authors' code).
        steps: number of steps; overrides `epochs` where set.
        batch_size: frames of a minibatch.
        clips_per_batch: clips that the generator reads for it, each modulating an equal share of the frames.
        learning_rate: of Adam.
        dropout: drop probability, rounded to 1/256.
        l1, bone_length: as in `PretrainConfig`; None for the value of the layout's paper.
        seed: of shuffling and dropout.
        precision: of matrix products on GPUs and TPUs.
        steps_per_dispatch: steps between two reports of the loss.
    """

    epochs: int = 100
    steps: int | None = None
    batch_size: int = 32
    clips_per_batch: int = 4
    learning_rate: float = 1e-4
    dropout: float = 0.3
    l1: float | None = None
    bone_length: float | None = None
    seed: int = 0
    precision: Precision = "float32"
    steps_per_dispatch: int = 100

    def __post_init__(self):
        check_at_least(self, "epochs", "batch_size", "clips_per_batch", "steps_per_dispatch", "steps")
        check_one_of(self, "precision", get_args(Precision))
        _check_shares(self)
        check_probability(self, "dropout")
        check_positive(self, "learning_rate")
        check_not_negative(self, "l1", "bone_length", "seed")


def num_clip_columns(layout: FrameLayout) -> int:
    """Returns F, the number of joint columns of x, which the frames of a clip consist of."""
    return int(layout.joint_inputs.sum())


def _check_shares(config: Any) -> None:
    """Checks that the clips of a minibatch can modulate equal shares of its frames."""
    size = config.batch_size
    check_field(config, "clips_per_batch", f"divide batch_size {size}", lambda clips: size % clips == 0)
