"""`pfnn-jax download`: published motion capture."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command


@dataclass(frozen=True, kw_only=True)
class Download(Command):
    """Download a published data set, or some of its styles. Run it again to continue an interrupted download.

    Attributes:
        dataset: 100style (Mason et al. 2022, CC BY 4.0; 1.5 GB to download, about 3 GB on disk).
        out: folder for it. Files that it already holds are not downloaded again.
        styles: names of the styles to download, such as Old,Zombie; all by default.
        url: address of a copy of the archive, on a server that supports range requests.
        overwrite: replace files that exist with other content.
    """

    dataset: Annotated[Positional[Literal["100style"]], tyro.conf.arg(metavar="100style")]
    out: Path
    styles: Annotated[str | None, tyro.conf.arg(metavar="NAME,NAME")] = None
    url: str | None = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.download import ARCHIVE_URL, download_100style

        styles = None if self.styles is None else [name.strip() for name in self.styles.split(",")]
        with progress("downloading", in_bytes=True) as report:
            got = download_100style(
                self.out, styles, url=self.url or ARCHIVE_URL, overwrite=self.overwrite, progress_callback=report
            )
        print(f"{got.folder}: {got.clips} clips; next: pfnn-jax prepare {got.folder} --kind 100style --out DATASET")
        return asdict(got)
