"""`pfnn-jax share`: a run as a folder to pass on."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from pfnn_jax.cli.command import Command, Run, open_run, print_notes


@dataclass(frozen=True, kw_only=True)
class Share(Command):
    """Write a run as a folder to pass on, with a model card for the Hugging Face Hub. The state of training, metrics,
    uploads and the names of your folders stay behind.

    Attributes:
        run_path: a run, or `base`.
        out: folder to write; it is a run itself.
        styles: names of the styles to pass on; by default all.
        licence: of the whole, for the card, for example "CC BY 4.0".
        differences: also pass on excerpts of the data, from which styles that are learned later learn to turn. Only if
            the data may be passed on.
        overwrite: replace an earlier folder.
    """

    run_path: Run
    out: Path
    styles: tuple[str, ...] | None = None
    licence: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None
    differences: bool = False
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.run_config import list_styles, style_note

        path = open_run(self.run_path)
        names = list_styles(path) if self.styles is None else self.styles
        for name in names:
            style_note(path, name)
        from pfnn_jax.cli.progress import stages
        from pfnn_jax.training.restyling import has_differences
        from pfnn_jax.workflows.share_folder import check_share, share_run

        check_share(path, self.out, self.overwrite)
        with stages("sharing") as stage:
            stage("writing the network and its styles")
            share_run(
                path,
                self.out,
                styles=names,
                licence=self.licence,
                differences=self.differences,
                overwrite=self.overwrite,
            )
        size = sum(file.stat().st_size for file in self.out.rglob("*") if file.is_file())
        print(f"{self.out}: {len(names)} style{'s' * (len(names) != 1)}, {size / 1e6:.1f} MB")
        if has_differences(path) and not self.differences:
            print_notes(self.out, ["has no excerpts of the data (--differences): styles learned on it turn less well"])
        if self.licence is None:
            print_notes(self.out / "README.md", ["states no licence (--licence)"])
        print(f"next: {shlex.join(['hf', 'upload', f'OWNER/{self.out.name}', str(self.out)])}")
        return {"out": self.out, "styles": names, "bytes": size}
