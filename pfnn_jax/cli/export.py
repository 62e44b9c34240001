"""`pfnn-jax export`: networks for game engines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from pfnn_jax.cli.command import Command, Run, check_output, open_run, parse_choice, print_notes
from pfnn_jax.errors import InputError
from pfnn_jax.interop.export.formats import Format
from pfnn_jax.motion.length_unit import UnitName

OF_NETWORKS = ("film_input", "opset", "tables")
OF_CLIPS = ("onto", "onto_roles", "onto_unit", "root_motion")
"""Options that have an effect on one kind of export only."""


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Export a run for game engines: its network, with a description of everything that they need to run it, or a style
    as clips of a character.

    Attributes:
        run_path: a run, or `base`.
        format: onnx or stablehlo, a function for one style; bins, the files of the authors' demos; or glb, a character
            with the style's moves as clips that loop: idle, walk, turns, and strafes where the network can make them.
        out: folder of the export; a .glb or .vrm file for the format glb.
        style: one of the run's styles, or a mixture `A:0.5+B:0.5` whose weights sum to one. By default the motion is
            style-agnostic, or on a FiLM run in the mean of its styles; bins and --film-input export all styles.
        film_input: for FiLM runs: make the style an input of the network, so that an engine can change it.
        tables: of bins of phase-functioned networks: 4 tables over the phase, which determine the network (the
            default), or the 50 that the authors' demos read.
        opset: version of the ONNX operators, from 15 (Unity Sentis 2.1) to 22; by default 18.
        onto: for glb: your own character (.glb, .gltf, .vrm); by default a mannequin.
        onto_roles: for glb: JSON file that names the joints of bones of the character; the others are found.
        onto_unit: for glb: the unit of the character, if it is found wrongly.
        root_motion: for glb: let the clips travel, by the character's root joint or its hips.
        overwrite: replace an earlier export.
    """

    run_path: Run
    format: Literal[Format, "glb"]
    out: Path
    style: str | None = None
    film_input: bool = False
    opset: int | None = None
    tables: Literal[4, 50] | None = None
    onto: Annotated[Path | None, tyro.conf.arg(metavar="CHARACTER")] = None
    onto_roles: Path | None = None
    onto_unit: float | UnitName | None = None
    root_motion: bool = False
    overwrite: bool = False

    def run(self) -> Any:
        for option in OF_NETWORKS if self.format == "glb" else OF_CLIPS:
            if getattr(self, option):
                formats = "onnx, stablehlo or bins" if option in OF_NETWORKS else "glb"
                rule = f"belongs to --format {formats}: leave it out"
                raise InputError("command line", option.replace("_", "-"), self.format, rule)
        return self._write_clips() if self.format == "glb" else self._write_network(self.format)

    def _write_clips(self) -> Any:
        """Writes the moves of a style onto a character, and prints which it cannot make."""
        from pfnn_jax.cli.motion_file import MotionFile

        file = MotionFile(**{option: getattr(self, option) for option in OF_CLIPS})
        file.check_set(self.out, self.overwrite)
        path = open_run(self.run_path)
        style = parse_choice(self.style, path)
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.workflows.clip_set import make_clip_set

        with stages("exporting") as stage:
            stage("compiling the network and making the moves")
            moves = make_clip_set(path, style)
            stage("writing")
            file.write_set(self.out, moves.clips, self.overwrite)
        print_notes(path, moves.notes)
        print(f"{self.out}: {', '.join(moves.clips)}")
        seconds = {name: (clip.num_frames - 1) / clip.fps for name, clip in moves.clips.items()}
        return {"out": self.out, "format": "glb", "clips": seconds}

    def _write_network(self, format: Format) -> Any:
        check_output(self.out, self.overwrite)
        path = open_run(self.run_path)
        style = parse_choice(self.style, path)
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.interop.export.run import export_run
        from pfnn_jax.run import load_run

        run = load_run(path)
        with stages("exporting") as stage:
            stage(f"converting the network to {format} and checking it")
            description = export_run(
                run.path,
                format,
                self.out,
                style=style,
                film_input=self.film_input,
                opset=self.opset,
                tables=self.tables,
                overwrite=self.overwrite,
            )
        names = [style["name"] for style in description["styles"]]
        print(f"{self.out}: {format}, {description['layout']['name']}, {', '.join(names) or 'style-agnostic'}")
        network = description["network"]
        shown = {key: network[key] for key in ("kind", "file", "opset", "relative_error") if key in network}
        return {"out": self.out, "format": format, "styles": names, **shown}
