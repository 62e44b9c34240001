"""From a command line to a command, and from bad input to one line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro

from pfnn_jax.cli.data import LabelPhase, PlotPhase, Prepare
from pfnn_jax.cli.download import Download
from pfnn_jax.cli.exporting import Export
from pfnn_jax.cli.learning import Demo, FewShot, Pretrain
from pfnn_jax.cli.rendering import Render
from pfnn_jax.cli.running import Benchmark, Evaluate, Generate, ImportReleased, Predict
from pfnn_jax.cli.viewing import Play
from pfnn_jax.errors import InputError, TrainingError
from pfnn_jax.io.files import json_text, write_whole

COMMANDS = {
    "demo": Demo,
    "download": Download,
    "prepare": Prepare,
    "pretrain": Pretrain,
    "few-shot": FewShot,
    "generate": Generate,
    "evaluate": Evaluate,
    "label-phase": LabelPhase,
    "plot-phase": PlotPhase,
    "render": Render,
    "import-released": ImportReleased,
    "predict": Predict,
    "play": Play,
    "export": Export,
    "benchmark": Benchmark,
}


def parse(args: Sequence[str] | None) -> Any:
    """The command that a command line names, its settings checked.

    Raises:
        InputError: if a setting breaks a rule of its configuration.
        SystemExit: for a command, option or choice that does not exist: tyro has explained it on standard error.
    """
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS, args=args, prog="pfnn-jax", description="Stylised character locomotion from short clips."
        )
    except InputError:
        raise
    except ValueError as error:  # from the configurations' own checks
        raise InputError("command line", "settings", str(error).removesuffix("."), "see --help") from error


def run(args: Sequence[str] | None) -> None:
    """Runs a command line; bad input ends with one line on standard error and exit code 2 (what `parse` cannot read at
    all, with tyro's own message and the same code)."""
    try:
        command = parse(args)
        result = command.run()
        if command.json is not None:
            _write_json(command.json, result)
    except (InputError, TrainingError) as error:
        print(f"pfnn-jax: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _write_json(path: Path, result: Any) -> None:
    write_whole(path, json_text(result))
