"""The settings of style transfer. Importing this file does not import JAX."""

from __future__ import annotations

from dataclasses import dataclass

from pfnn_jax.errors import check_at_least, check_field, check_not_negative, check_positive, check_probability


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
        dropout: drop probability before the encoder and before the decoder (0.25 in the authors' code).
        seed: of initialisation, shuffling and dropout.
        steps_per_dispatch: steps that are compiled into one call, and between two reports of the loss.
    """

    autoencoder: AutoencoderConfig = AutoencoderConfig()
    steps: int = 3500
    batch_size: int = 4
    learning_rate: float = 1e-3
    l1: float = 0.01
    dropout: float = 0.0
    seed: int = 0
    steps_per_dispatch: int = 50

    def __post_init__(self):
        check_at_least(self, "steps", "batch_size", "steps_per_dispatch")
        check_positive(self, "learning_rate")
        check_not_negative(self, "l1", "seed")
        check_probability(self, "dropout")
