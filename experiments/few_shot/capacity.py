"""Is it the adapter's size that limits what is learned?

Question  does a larger or another adapter come nearer to the actor's turns, from the same rows?
Method    CP of rank 10, 30 and 90, a bias, a diagonal and a full adapter, learned from the clip and restyled rows in
          the same way; and a full adapter from the style's own turns.
Verdict   (feminine, rows of runs among the restyled ones) CP of rank 10 3.24 / 3.05, 30 3.21 / 3.09, 90 3.24 / 3.12:
          the rank does not limit what is learned. A bias is too little: 4.22 / 4.91.
Run       python -m experiments.few_shot.capacity --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import tyro

from experiments.common.few_shot_recipes import learn_own_turns
from experiments.common.turning_folds import FoldConfig, Method, run_methods
from experiments.common.turning_table import OWN_TURNS, PAPER
from experiments.common.varied_restyling import BASE, learn_base
from pfnn_jax.models.config import AdapterConfig

ADAPTERS = {
    "CP, rank 10": AdapterConfig("cp", 10),
    "CP, rank 90": AdapterConfig("cp", 90),
    "bias": AdapterConfig("bias"),
    "diagonal": AdapterConfig("diagonal"),
    "full": AdapterConfig("full"),
}
"""Adapters next to CP of rank 30, which is the default."""


METHODS = {name: Method(partial(learn_base, adapter=adapter)) for name, adapter in ADAPTERS.items()} | {
    "own turns, full": Method(partial(learn_own_turns, adapter=ADAPTERS["full"]))
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "capacity", METHODS, (PAPER, BASE, OWN_TURNS))
