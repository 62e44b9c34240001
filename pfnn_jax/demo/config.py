"""Sizes of the demo, in a module without JAX so that the command line loads quickly."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DemoConfig:
    """Sizes of the demo; the defaults take one to three minutes on two cores.

    Attributes:
        seconds_per_style: seconds of motion of each of the 8 pretraining styles, before mirroring.
        clip_seconds: seconds of straight walking from which the ninth style is learned.
        hidden: H.
        steps, batch_size, learning_rate: settings of pretraining.
        walk_seconds: seconds of generated motion along the figure-eight.
        seed: seed of the data and of training.
    """

    seconds_per_style: float = 60.0
    clip_seconds: float = 3.0
    hidden: int = 512
    steps: int = 2500
    batch_size: int = 128
    learning_rate: float = 1e-3
    walk_seconds: float = 21.0
    seed: int = 0
