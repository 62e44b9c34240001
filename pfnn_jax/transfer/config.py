"""The settings of style transfer. Importing this file does not import JAX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pfnn_jax.errors import (
    check_at_least,
    check_field,
    check_not_negative,
    check_one_of,
    check_positive,
    check_probability,
)
from pfnn_jax.training.config import Precision

Start = Literal["content", "noise"]


@dataclass(frozen=True)
class AutoencoderConfig:
    """Sizes of a motion autoencoder (Holden 2017, Eq. 1 and 2).

    Attributes:
        filters: F hidden units of every pooled frame.
        width: W frames that a filter spans, odd.
        tied: whether the decoder uses the encoder's filters, as in the paper; the released network has its own.
    """

    filters: int = 256
    width: int = 25
    tied: bool = True

    def __post_init__(self):
        check_at_least(self, "filters", "width")
        check_field(self, "width", "be odd", lambda width: width % 2 == 1)


@dataclass(frozen=True)
class AutoencoderTrainingConfig:
    """How a motion autoencoder is trained (Holden 2017, Eq. 3).

    Attributes:
        autoencoder: its sizes.
        steps: number of steps.
        batch_size: windows of a minibatch.
        learning_rate: the largest of Adam: it rises over the first twentieth of the steps, then falls to zero along a
            cosine (1e-5 throughout in the authors' code).
        l1: α of Eq. 3, on the mean absolute weight of the filters, as in the authors' code (0.01).
        dropout: drop probability before the encoder and before the decoder (0.25 in the authors' code), rounded to
            1/256.
        seed: of initialisation, shuffling and dropout.
        precision: of matrix products and, but for bfloat16, of convolutions on GPUs and TPUs.
        steps_per_dispatch: steps that are compiled into one call, and between two reports of the loss.
    """

    autoencoder: AutoencoderConfig = AutoencoderConfig()
    steps: int = 3500
    batch_size: int = 4
    learning_rate: float = 1e-3
    l1: float = 0.01
    dropout: float = 0.0
    seed: int = 0
    precision: Precision = "float32"
    steps_per_dispatch: int = 50

    def __post_init__(self):
        check_at_least(self, "steps", "batch_size", "steps_per_dispatch")
        check_one_of(self, "precision", get_args(Precision))
        check_positive(self, "learning_rate")
        check_not_negative(self, "l1", "seed")
        check_probability(self, "dropout")


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses of a result (Holden et al. 2017, Eq. 4 to 9).

    Content and style are the paper's. It gives no others: those of the constraints come from
    `experiments/transfer_weights.py`.

    Attributes:
        content: c, of the hidden units' mean squared difference from the content's.
        style: s, of the Gram matrix' mean squared difference from the style's.
        foot: of the mean squared velocity of feet on the ground, (m/s)².
        bone: of the mean squared error of bone lengths, cm².
        trajectory: of the mean squared error of the root's velocity, (m/s)² and (rad/s)².
    """

    content: float = 1.0
    style: float = 0.01
    foot: float = 1.0
    bone: float = 0.01
    trajectory: float = 1.0

    def __post_init__(self):
        check_not_negative(self, "content", "style", "foot", "bone", "trajectory")


@dataclass(frozen=True)
class OptimisationConfig:
    """How a clip is transferred by optimisation over its hidden units (Holden et al. 2016).

    Attributes:
        weights: of the losses; content and style act in the first loop, the constraints in the second.
        iterations: steps of the first loop.
        constraint_iterations: steps of the second.
        learning_rate: of Adam in both. The authors' code has 0.01; hidden units of the package's autoencoder are two to
            four times as large as theirs, and 250 steps of 0.01 end before the loss has converged.
        start: where the hidden units begin: at the content's, or at noise, as in the authors' code, which takes more
            iterations.
        scale_speed: whether the content's velocity is scaled by the style's step length over the content's, or kept.
        keep_detail: whether only the change that the style makes passes the autoencoder, and is added to the content,
            or the whole motion, as in the paper.
    """

    weights: LossWeights = LossWeights()
    iterations: int = 250
    constraint_iterations: int = 100
    learning_rate: float = 0.05
    start: Start = "content"
    scale_speed: bool = True
    keep_detail: bool = True

    def __post_init__(self):
        check_at_least(self, "iterations", "constraint_iterations", least=0)
        check_positive(self, "learning_rate")
        check_one_of(self, "start", get_args(Start))


@dataclass(frozen=True)
class TransformationConfig:
    """Sizes of the transformation network.

    Attributes:
        hidden: units of both hidden layers.
        width: W frames that a filter spans, odd.
    """

    hidden: int = 128
    width: int = 25

    def __post_init__(self):
        check_at_least(self, "hidden", "width")
        check_field(self, "width", "be odd", lambda width: width % 2 == 1)


@dataclass(frozen=True)
class TransformationTrainingConfig:
    """How a transformation network is trained for one style.

    Attributes:
        network: its sizes.
        weights: of the losses.
        epochs: passes over the windows of the contents (100 in the paper).
        batch_size: windows of a minibatch.
        learning_rate: of Adam at the first step; it falls to zero along a cosine.
        keep_detail: whether constraints act on the result that adds only the network's change to the content, or on
            the network's own motion, as in the paper.
        held_out: share of the contents that training does not see, and that the losses are measured on.
        seed: of initialisation and shuffling.
        precision: of matrix products and, but for bfloat16, of convolutions on GPUs and TPUs.
        steps_per_dispatch: steps that are compiled into one call, and between two reports of the loss.
    """

    network: TransformationConfig = TransformationConfig()
    weights: LossWeights = LossWeights()
    epochs: int = 100
    batch_size: int = 8
    learning_rate: float = 1e-3
    keep_detail: bool = True
    held_out: float = 0.1
    seed: int = 0
    precision: Precision = "float32"
    steps_per_dispatch: int = 25

    def __post_init__(self):
        check_at_least(self, "epochs", "batch_size", "steps_per_dispatch")
        check_one_of(self, "precision", get_args(Precision))
        check_positive(self, "learning_rate")
        check_not_negative(self, "seed")
        check_probability(self, "held_out")
