"""`pfnn-jax transfer`: a clip in the style of another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Reading, check_output
from pfnn_jax.errors import InputError
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class Transfer(Command):
    """Put a clip into another style: that of another clip, or one that `train-transfer` has trained a network for.

    The result is on the clip's own skeleton, at its own frame rate and in its own unit, with Y up.

    Attributes:
        content: BVH, GLB, glTF or VRM file of the clip to transfer.
        style: the style clip, one file or several of one style; or, with --run, the name of a style of the
            run, which may be left out if it has one only. Files need no training.
        run_path: a run of `train-transfer`, for its styles; or, with files as style, for its autoencoder.
        out: the BVH file to write.
        strength: 0 is the content, 1 the result; up to 1.5, the style is exaggerated.
        parts: of the body that take the style: all, upper, lower, or arms. The others keep the content's motion.
        foot_ik: feet are held in place while those of the content are in contact; `--no-foot-ik` leaves them as the
            network makes them.
        roles: JSON file that names the joints' roles.
        reading: what is known about the files, where it is not found or wrong.
        overwrite: replace an existing file.
    """

    content: Annotated[Positional[Path], tyro.conf.arg(metavar="CONTENT")]
    out: Path
    style: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STYLE [STYLE ...]|NAME")] = ()
    run_path: Annotated[Path | None, tyro.conf.arg(name="run", metavar="RUN")] = None
    strength: float = 1.0
    parts: Literal["all", "upper", "lower", "arms"] = "all"
    foot_ik: bool = True
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False

    def run(self) -> Any:
        check_output(self.out, self.overwrite, ".bvh")
        chosen = self._chosen()
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.motion.bvh import write_bvh
        from pfnn_jax.workflows.transfer import transfer_clip

        with stages("transferring") as stage:
            result = transfer_clip(
                self.content,
                **chosen,
                run=self.run_path,
                strength=self.strength,
                parts=self.parts,
                foot_ik=self.foot_ik,
                reading=self.reading,
                roles_file=self.roles,
                progress_callback=lambda share, what: stage(what),
            )
        write_bvh(self.out, result.clip, unit=result.unit, overwrite=self.overwrite)
        for note in result.notes:
            print(f"note: {note}")
        length = result.clip.num_frames / result.clip.fps
        print(f"{self.out}: {length:.1f} s of motion, made in {result.seconds:.1f} s")
        return {
            "out": self.out,
            "frames": result.clip.num_frames,
            "fps": result.clip.fps,
            "notes": result.notes,
            "seconds": result.seconds,
        }

    def _chosen(self) -> dict[str, Any]:
        """Returns the style as arguments of `transfer_clip`: clips by their suffix, else the name of one of the run's.

        Raises:
            InputError: for neither, for a mixture of both, for several names, or for a name without a run.
        """
        from pfnn_jax.motion.clip_files import is_clip_file

        clips = [style for style in self.style if is_clip_file(style)]
        if clips and len(clips) == len(self.style):
            return {"style": [Path(clip) for clip in clips]}
        shown = " ".join(self.style) or "none"
        if self.run_path is None:
            rule = "must be files of clips, or the name of a style of --run RUN"
            raise InputError("command line", "style", shown, rule)
        if len(self.style) > 1:
            raise InputError(
                "command line", "style", shown, "must be files of clips, or one name of a style of the run"
            )
        return {"style_name": self.style[0] if self.style else None}
