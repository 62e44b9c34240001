"""`pfnn-jax generate`: motion in a style along a path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pfnn_jax.cli.command import FLAT, Command, Run, open_run, parse_choice
from pfnn_jax.cli.motion_file import MotionFile
from pfnn_jax.errors import InputError
from pfnn_jax.inference.modes import Mode


@dataclass(frozen=True, kw_only=True)
class Generate(Command):
    """Generate motion in a style along a path, and write it to a BVH or GLB file, or onto your own character.

    Attributes:
        run_path: a run, or `base`.
        style: one of its styles, or a mixture `A:0.5+B:0.3+C:0.2` whose weights sum to one. By default the motion is
            style-agnostic, or on a FiLM run in the mean of its styles.
        path: straight, circle, figure-eight, or a CSV file of points x,z in metres.
        size: length of a straight path or radius of the others, in metres.
        speed: in metres per second; by default the style's own.
        seconds: duration; by default what the path takes.
        published_loop: use the loop of the papers' demos, in which the network alone decides speed and direction. By
            default a controller keeps the character to the path and its speed.
        mode: cubic evaluates the network itself; nearest50 and constant50 a table of 50 slices of a global phase, in
            the published loop.
        foot_ik: feet are held in place while they are in contact; `--no-foot-ik` leaves them as the network predicts
            them.
        out: the file to write: .bvh in centimetres, .glb, .vrm for a VRM character, or .vrma for every VRM character.
        file: whose body moves.
        name: of the clip in a GLB file; by default its style.
        overwrite: replace an existing file.
    """

    run_path: Run
    out: Path
    style: str | None = None
    path: str = "figure-eight"
    size: float | None = None
    speed: float | None = None
    seconds: float | None = None
    published_loop: bool = False
    mode: Mode = "cubic"
    foot_ik: bool = True
    file: Annotated[MotionFile, FLAT] = MotionFile()
    name: str | None = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.motion.paths import make_path

        self.file.check(self.out, self.overwrite)
        if self.mode != "cubic" and not self.published_loop:
            raise InputError("command line", "mode", self.mode, "must be cubic without --published-loop")
        path = make_path(self.path, self.size)
        run_path = open_run(self.run_path)
        style = parse_choice(self.style, run_path)
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.run import load_run, load_style
        from pfnn_jax.workflows.generate import generate_clip

        run = load_run(run_path)
        for name in [style] if isinstance(style, str) else style or ():
            load_style(run, name)
        options: Any = {"speed": self.speed, "seconds": self.seconds, "foot_ik": self.foot_ik}
        with stages("generating") as stage:
            stage("compiling the network and walking the path")
            clip = generate_clip(run, style, path, published_loop=self.published_loop, mode=self.mode, **options)
            stage("writing")
            clip = self.file.write(self.out, clip, self.overwrite, self.name)
        seconds = clip.num_frames / clip.fps
        print(f"{self.out}: {seconds:.1f} s")
        return {"out": self.out, "seconds": seconds, "frames": clip.num_frames}
