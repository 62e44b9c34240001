"""From a command line to a sub-command, and from bad input to one line."""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import NoReturn

from pfnn_jax import __version__
from pfnn_jax.errors import InputError, LostProcessError, TrainingError

COMMANDS = {
    "demo": "Run the full pipeline on procedural motion and write a report.",
    "download": "Download a published data set.",
    "prepare": "Turn folders of BVH or glTF clips into a dataset for training.",
    "pretrain": "Train a network and its styles on a dataset.",
    "few-shot": "Learn a new style from one clip.",
    "sample": "List the sample clips, or write one.",
    "generate": "Generate motion in a style along a path.",
    "retarget": "Put a clip onto your own character or rig.",
    "transfer": "Put a clip into the style of another.",
    "train-transfer": "Train a network that puts any clip into a style.",
    "play": "Drive a character in the browser.",
    "render": "Draw clips as a page, a film or a picture.",
    "evaluate": "Measure one-step errors of a run on clips.",
    "export": "Export a run for game engines.",
    "style export": "Write a style of a run as one file.",
    "style import": "Save the style of a file in a run.",
    "style show": "Show what the file of a style says about it.",
    "share": "Write a run as a folder to pass on, with a model card.",
    "import-released": "Make a run from the authors' released weights.",
    "predict": "Evaluate a run's network on rows of a file.",
    "skeleton": "Show which joints of a clip are taken for which parts of the body.",
    "label-phase": "Label the phase of a clip.",
    "plot-phase": "Plot the local phases of hands and toes.",
    "benchmark": "Time training and inference on this machine.",
}
"""Name and summary of every sub-command; FIRST-SECOND and FIRST SECOND are the class FirstSecond in the module
`pfnn_jax.cli.first_second`."""

TRY_AGAIN = 75
"""Exit code where another process is lost and the same command may succeed: EX_TEMPFAIL of sysexits.h."""

PREFIXES = {"AdapterConfig": "adapter.", "TuningConfig": "tuning.", "GeneratorConfig": "generator-"}
"""Configurations whose fields are options with a prefix."""


def run(args: Sequence[str] | None) -> None:
    """Runs a command line.

    Raises:
        SystemExit: with code 2 for bad input, which one line on standard error names; with code 75 where another of
            several processes is lost; with code 0 after help.
    """
    words = list(sys.argv[1:] if args is None else args)
    try:
        command = parse(words)
        if args is None and getattr(command, "keep_compiled", True):  # a program that calls `main` has its own settings
            from pfnn_jax.io.compilation_cache import name_private_cache

            name_private_cache()
        with command.ending():
            try:
                result = command.run()
                if command.json is not None and result is not None:  # of several processes one has a result
                    from pfnn_jax.io.files import json_text, write_whole

                    write_whole(command.json, json_text(result))
            except (InputError, TrainingError) as error:
                _refuse(str(error))
            except LostProcessError as error:
                _refuse(str(error), TRY_AGAIN)
            except OSError as error:
                if isinstance(error, BrokenPipeError) or error.errno is None:
                    raise
                from pfnn_jax.io.files import failure

                file = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "system"
                _refuse(f"{file}: file: {failure(error)}; must be readable, and what is written writable")
    except InputError as error:
        _refuse(str(error))


def parse(words: list[str]):
    """Returns the sub-command that a command line names, with its options checked. Only its own module is imported.

    Raises:
        InputError: for an unknown sub-command, or an option that breaks a rule of its configuration.
        SystemExit: after `--help` and `--version`, and for options that cannot be parsed, which tyro explains.
    """
    name, options = split_command(words)
    if name in ("--help", "-h"):
        print(usage())
        raise SystemExit(0)
    if name == "--version":
        print(f"pfnn-jax {__version__}")
        raise SystemExit(0)
    if name not in COMMANDS:
        _refuse_command(name, options)
    import tyro

    try:
        command = tyro.cli(
            load_command(name), args=options, prog=f"pfnn-jax {name}", config=(tyro.conf.FlagCreatePairsOff,)
        )
    except InputError:
        raise
    except ValueError as error:  # from a configuration's own checks
        raise InputError("command line", "options", str(error).removesuffix("."), "see --help") from error
    return replace(command, given=given_options(options))


def split_command(words: Sequence[str]) -> tuple[str, list[str]]:
    """Returns the name of a sub-command, of one word or two, and the words after it; the name need not be known."""
    count = 2 if " ".join(words[:2]) in COMMANDS else 1
    return " ".join(words[:count]), list(words[count:])


def load_command(name: str) -> type:
    """Returns the class of a sub-command."""
    words = re.split("[- ]", name)
    module = import_module(f"pfnn_jax.cli.{'_'.join(words)}")
    return getattr(module, "".join(word.capitalize() for word in words))


def given_options(words: Iterable[str]) -> frozenset[str]:
    """Returns the names of the options among the words, written as attributes: `learning_rates`, `tuning.epochs`.

    A setting that is on by default is turned off by an option of its own: `--no-decay` sets `decay`.
    """
    options = (word[2:].partition("=")[0] for word in words if word.startswith("--"))
    return frozenset(option.removeprefix("no-").replace("-", "_") for option in options)


def usage(group: str = "") -> str:
    """Returns the help of the command itself, or of the sub-commands that begin with a word."""
    listed = {name: summary for name, summary in COMMANDS.items() if name.startswith(group)}
    commands = "\n".join(f"  {name:<16} {summary}" for name, summary in listed.items())
    return f"""usage: pfnn-jax [--help] [--version] COMMAND ...

Stylised character locomotion from short clips.

commands:
{commands}

`pfnn-jax COMMAND --help` lists the options of a command."""


def in_options(message: str) -> str:
    """Returns a message of the Python API in terms of the command line: `overwrite=True` becomes `--overwrite`."""

    def option(match: re.Match[str]) -> str:
        return f"--{PREFIXES.get(match[1], '')}{match[2].replace('_', '-')}"

    message = re.sub(r"\b(\w+Config)\.(\w+)", option, message)
    return re.sub(r"\b([a-z_]+)=True\b", lambda match: f"--{match[1].replace('_', '-')}", message)


def _refuse_command(name: str, words: Sequence[str]) -> NoReturn:
    """Refuses the name of a sub-command that is unknown, or is only the first word of several."""
    group = [command for command in COMMANDS if name and command.startswith(f"{name} ")]
    if group and words[:1] in (["--help"], ["-h"]):
        print(usage(f"{name} "))
        raise SystemExit(0)
    found = " ".join([name, *words[:1]]) if group else name
    near = difflib.get_close_matches(found, COMMANDS, 1) if found != name or not group else []
    rule = f"did you mean {near[0]}?" if near else f"must be one of {', '.join(group or COMMANDS)}"
    raise InputError("command line", "command", found or "none", f"{rule}; see pfnn-jax --help" if near else rule)


def _refuse(message: str, code: int = 2) -> NoReturn:
    print(f"pfnn-jax: {in_options(message)}", file=sys.stderr)
    raise SystemExit(code)
