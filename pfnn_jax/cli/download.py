"""The command that fetches published motion capture."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import Command
from pfnn_jax.cli.progress import byte_progress
from pfnn_jax.motion.datasets.download import RECORD, download_100style


@dataclass(frozen=True, kw_only=True)
class Download(Command):
    """Fetch a published data set: size and checksum verified; run it again after a lost connection to go on.

    Attributes:
        dataset: 100style (Mason et al. 2022, CC BY 4.0; 1.5 GB to fetch, some 3 GB unpacked).
        out: folder for it.
        record_url: its Zenodo record, or a copy of it elsewhere.
        overwrite: replace an earlier download.
    """

    dataset: Annotated[Argument[Literal["100style"]], tyro.conf.arg(metavar="100style")]
    out: Path
    record_url: str = RECORD
    overwrite: bool = False

    def run(self) -> Any:
        with byte_progress() as progress:
            got = download_100style(self.out, record_url=self.record_url, overwrite=self.overwrite, progress=progress)
        takes = sum(1 for _ in got.folder.rglob("*.bvh"))
        print(f"{got.folder}: {takes} takes; now: pfnn-jax prepare {got.folder} --kind 100style --out DATASET")
        return {"folder": got.folder, "takes": takes, **asdict(got.published)}
