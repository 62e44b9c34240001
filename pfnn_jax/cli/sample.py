"""`pfnn-jax sample`: clips to learn a style from, for those who have none."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, check_output
from pfnn_jax.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Sample(Command):
    """List the sample clips of the package, or write one as a BVH file.

    Attributes:
        name: of the clip to write; without a name the clips are listed.
        out: BVH file to write.
        overwrite: replace an existing file.
    """

    name: Annotated[Positional[str | None], tyro.conf.arg(metavar="[NAME]")] = None
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.bvh")] = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.workflows.samples import sample_clips

        clips = sample_clips()
        if self.name is None:
            self._refuse_output()
            for name, path in clips.items():
                print(f"{name:<10} {path}")
            return {name: str(path) for name, path in clips.items()}
        if self.name not in clips:
            raise InputError("command line", "name", self.name, f"must be one of {', '.join(clips)}")
        if self.out is None:
            raise InputError("command line", "--out", "absent", "pass the BVH file to write")
        from pfnn_jax.io.files import write_whole

        check_output(self.out, self.overwrite, ".bvh")
        write_whole(self.out, clips[self.name].read_bytes())
        print(f"{self.out}: a walk of 4 s in the style {self.name}")
        return {"sample": self.name, "file": str(self.out)}

    def _refuse_output(self) -> None:
        if self.out is not None:
            raise InputError("command line", "name", "absent", "pass the name of the sample that --out is to contain")
