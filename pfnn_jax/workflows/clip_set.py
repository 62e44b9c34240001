"""The clips of a style that an engine's blend tree wants: idle, walk, turns and strafes."""

from __future__ import annotations

from pathlib import Path

from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.moves import MoveClips, make_moves
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.run import Run
from pfnn_jax.workflows.runs import as_run


def make_clip_set(run: Run | str | Path, style: StyleChoice) -> MoveClips:
    """Returns the moves of a style of a run, each a cycle that closes; see `control.moves`.

    Args:
        run: a run, or its directory.
        style: name of one of its styles; a mixture by name and weight; or None for style-agnostic motion.

    Raises:
        InputError: for a run or style that does not exist, or a style that makes no move.
    """
    run = as_run(run)
    weights = choice_weights(run, style)
    controller = make_controller(run, tuple(weights))
    return make_moves(controller, controller.style_weights(weights or 0), run)
