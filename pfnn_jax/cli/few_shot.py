"""`pfnn-jax few-shot`: a new style from one clip."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command, Reading, Run, open_run, print_notes
from pfnn_jax.cli.several_hosts import HostsConfig, run_in_child
from pfnn_jax.errors import InputError
from pfnn_jax.models.config import CP_KINDS
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.training.config import MASON2018_FEW_SHOT, RESTYLED_FEW_SHOT, FewShotConfig, TuningConfig

GRID = frozenset(field.name for field in fields(FewShotConfig)) - {"seed"}

Recipe = Literal["default", "mason2018", "generator"]


@dataclass(frozen=True, kw_only=True)
class FewShot(Command):
    """Learn a new style from one clip. The shared network stays frozen.

    Attributes:
        run_path: a pretrained run, or `base` for the network of the package.
        clip: BVH, GLB, glTF or VRM file. A `.phase` file of the same name is used if there is one; otherwise phases are
            labelled.
        name: name of the new style.
        start: first frame to use, counted at the file's own frame rate.
        stop: frame before which to end; by default the end of the file.
        mirror: also learn from the mirrored clip. By default yes, unless left and right of the clip differ too much.
        roles: JSON file that names the joints' roles.
        reading: what is known about the file, where it is not found or wrong.
        recipe: default learns an adapter from the clip and from turns of the run's styles, put into the new style; FiLM
            parameters if the run has FiLM styles; and as mason2018 if the run keeps no turns. mason2018 is the paper's
            recipe (CP, 100 epochs at 1e-4, from the clip alone). generator tunes the run's FiLM generator (Mason 2022).
        overwrite: replace a style of this name.
        hosts: where several tune the generator.
        config: how to learn. Given options replace those of the default recipe; the others allow none of them
            except --seed.
        tuning: settings of --recipe generator.
    """

    run_path: Run
    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP")]
    name: str
    start: int = 0
    stop: int | None = None
    mirror: bool | None = None
    roles: Path | None = None
    reading: Reading = ReadOptions()
    recipe: Recipe = "default"
    overwrite: bool = False
    hosts: Annotated[HostsConfig, FLAT] = HostsConfig()
    config: Annotated[FewShotConfig, FLAT] = RESTYLED_FEW_SHOT
    tuning: TuningConfig = field(default_factory=TuningConfig)

    def run(self) -> Any:
        self._check_recipe()
        return self._learn() if self.hosts.coordinator is None else run_in_child(self._learn, self.hosts)

    def _learn(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.run_config import check_new_style

        path = open_run(self.run_path)
        check_new_style(path, self.name, self.overwrite)
        clip = ClipFile(self.clip, self.name, start=self.start, stop=self.stop, reading=self.reading)
        from pfnn_jax.run import load_run
        from pfnn_jax.workflows.learn import learn_style, tune_style

        run = load_run(path)
        options: Any = {"mirror": self.mirror, "roles_file": self.roles, "overwrite": self.overwrite}
        tuning = replace(self.tuning, seed=self.config.seed)
        if not self.hosts.is_first():
            return tune_style(run, clip, tuning, **options)
        with progress("learning") as report:
            options["progress_callback"] = lambda share, what: report(share, 1.0, what)
            if self.recipe == "generator":
                info = tune_style(run, clip, tuning, **options)
            else:
                info = learn_style(run, clip, self._grid(run), **options)
        print_notes(self.clip, info.get("notes", ()))
        self._print(info)
        for warning in info["warnings"]:
            print(f"warning: {warning}")
        print(f"next: {self._next()}")
        return info

    def _next(self) -> str:
        """Returns the command that walks in the learned style."""
        out = f"{self.name}_walk.bvh"  # another name than the clip's, which is often that of the style
        return shlex.join(["pfnn-jax", "generate", str(self.run_path), "--style", self.name, "--out", out])

    def _check_recipe(self) -> None:
        """Refuses options that the recipe would ignore."""
        if self.hosts.coordinator is not None and self.recipe != "generator":
            rule = "only --recipe generator trains on several hosts"
            raise InputError("command line", "recipe", f"{self.recipe} with --coordinator", rule)
        grid = sorted(self.given & GRID)
        tuning = sorted(name for name in self.given if name.startswith("tuning."))
        ignored = tuning if self.recipe != "generator" else grid
        if self.recipe == "mason2018":
            ignored = [name for name in grid if name != "precision"] + tuning
        if ignored:
            options = ", ".join(f"--{name.replace('_', '-')}" for name in ignored)
            rule = (
                "only --recipe generator reads them" if ignored == tuning else "leave them out, or leave out --recipe"
            )
            raise InputError("command line", "recipe", f"{self.recipe} with {options}", rule)

    def _grid(self, run: Any) -> FewShotConfig:
        """Returns the settings of the recipe, with the given options in their place."""
        from pfnn_jax.workflows.learn import default_config

        base = MASON2018_FEW_SHOT if self.recipe == "mason2018" else default_config(run)
        given = {name: getattr(self.config, name) for name in self.given & {*GRID, "seed"}}
        method = given.get("method", base.method)
        if "rank" in given and method not in CP_KINDS:
            raise InputError("command line", "rank", given["rank"], f"only CP adapters have a rank, method is {method}")
        return replace(base, **given)

    def _print(self, info: dict[str, Any]) -> None:
        mirrored = "and their mirror image" if info["mirrored"] else "not mirrored"
        if self.mirror is None and info["asymmetry"] is not None:
            mirrored += f" (left and right differ by {info['asymmetry']:.2f})"
        print(f"{self.name}: {info['frames']} frames, {mirrored}; {info['seconds']:.1f} s")
        if self.recipe == "generator":
            print(f"training loss {info['loss']:.4g}")
        else:
            chosen = {name: value for name, value in info["choice"].items() if name != "held_out_error"}
            print("chosen: " + ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in chosen.items()))
        error, without = info["held_out_error"], info["error_without_style"]
        print(
            f"held-out error {error:.3f}, without the style {without:.3f} (lower is better, 1.0 = predicting the mean)"
        )
