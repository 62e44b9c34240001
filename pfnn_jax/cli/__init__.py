"""The command `pfnn-jax`: one module for each sub-command, with its options and one function call.

What a sub-command computes with is imported when it runs. Help, refusals of bad options, and commands that need no
network therefore do not wait for JAX.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfnn_jax.cli.interrupts import ends_on_interrupt
from pfnn_jax.cli.pipes import ends_on_closed_pipe


def main(args: Sequence[str] | None = None) -> None:
    """Runs a command line.

    Bad input ends with one line on standard error and exit code 2; tyro explains options that it cannot parse in
    several lines, with the same code. Ctrl-C ends with code 130, a closed pipe with code 141.

    Args:
        args: the words after `pfnn-jax`. By default those that the program was started with; Ctrl-C then ends the
            process at once, whatever it is doing.
    """
    with ends_on_interrupt(process=args is None), ends_on_closed_pipe():
        from pfnn_jax.cli.command_line import run

        run(args)
