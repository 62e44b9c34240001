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
    """Download a published data set and verify it. Run it again after a lost connection to continue.

    Attributes:
        dataset: 100style (Mason et al. 2022, CC BY 4.0; 1.5 GB to download, about 3 GB on disk).
        out: folder for it.
        record_url: address of its Zenodo record, or of a copy.
        overwrite: replace an earlier download.
    """

    dataset: Annotated[Positional[Literal["100style"]], tyro.conf.arg(metavar="100style")]
    out: Path
    record_url: str | None = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.download import RECORD, download_100style

        with progress("downloading", in_bytes=True) as report:
            got = download_100style(
                self.out,
                record_url=self.record_url or RECORD,
                overwrite=self.overwrite,
                progress=lambda stage, done, total: report(done, total, stage),
            )
        takes = sum(1 for _ in got.folder.rglob("*.bvh"))
        print(f"{got.folder}: {takes} takes; next: pfnn-jax prepare {got.folder} --kind 100style --out DATASET")
        return {"folder": got.folder, "takes": takes, **asdict(got.published)}
