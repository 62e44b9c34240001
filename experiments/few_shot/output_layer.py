"""Does a style need parameters of its own on the outputs?

Question  an adapter on the second layer changes what the last hidden layer computes; poses stay in the span of the last
          layer, which knows the other styles alone. Does a style come nearer to its actor with an adapter there?
Method    next to CP of rank 30 on the second layer (31,352 numbers): CP of rank 30 on the last layer (24,160), and of
          rank 14 on both (26,328). Learned in the same loop from the clip and restyled rows; the second also from the
          style's own turns.
Verdict   (CP on the last layer, measured with rows of runs among the restyled ones) elderly 2.74 / 2.68, feminine
          3.02 / 2.94; on both layers elderly 2.76 / 2.65: as good as on the second layer alone (2.73 / 2.64,
          3.21 / 3.09) on styles like the known ones. With the present heading correction,
          on the last layer, on both, and by own turns on the last: active 4.28 / 4.67, 4.27 / 4.45, 3.33 / 3.47;
          elderly 2.62 / 2.70, 2.62 / 2.70, 2.07 / 2.07; feminine 3.15 / 3.13, 3.00 / 3.19, 2.44 / 2.24; normal
          2.73 / 2.59, 2.65 / 2.58, 2.22 / 2.30.
Run       python -m experiments.few_shot.output_layer --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import jax
import tyro

from experiments.common.few_shot_recipes import learn_own_turns
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import OWN_TURNS, PAPER
from experiments.common.varied_restyling import BASE, learn_base
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.network import config_of
from pfnn_jax.models.style import Style, StyleSum, init_style

OUTPUT = AdapterConfig("cp_output", 30)
BOTH = AdapterConfig("cp", 14), AdapterConfig("cp_output", 14)


def learn_both(fold: Fold, kind: NetworkKind) -> Style:
    """Returns the style that is learned by an adapter on the second and one on the last layer."""
    sizes, key = config_of(fold.network(kind).shared), jax.random.key(fold.seed)
    parts = [init_style(form, sizes, key=jax.random.fold_in(key, number)) for number, form in enumerate(BOTH)]
    return learn_base(fold, kind, start=StyleSum(tuple(parts)))


METHODS = {
    "CP on the last layer": Method(partial(learn_base, adapter=OUTPUT)),
    "CP on both layers": Method(learn_both),
    "own turns, CP on the last layer": Method(partial(learn_own_turns, adapter=OUTPUT)),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "output_layer", METHODS, (PAPER, BASE, OWN_TURNS))
