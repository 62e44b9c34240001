"""Published motion capture on this disk: fetched, verified, and unpacked whole or not at all.

100STYLE (Mason, Starke and Komura 2022, CC BY 4.0) is published at Zenodo, doi:10.5281/zenodo.8127870. The archive
comes into a file ending in `.part` beside the output, which stays there for the next run if the connection is lost for
good. Standard library only.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, swap_folder, write_whole
from pfnn_jax.motion.datasets.archive import ArchiveError, unpack
from pfnn_jax.motion.datasets.fetch import Patience, Progress, PublishedFile, fetch, read_record, verify

RECORD = "https://zenodo.org/api/records/8127870"
ARCHIVE = "100STYLE.zip"
TABLE = "Frame_Cuts.csv"
ORIGIN = "download.json"
"""File in the output that tells where it came from; a folder without it is never replaced."""


@dataclass(frozen=True)
class Downloaded:
    """What was fetched.

    Attributes:
        folder: the folder that `list_clips` reads: it holds `Frame_Cuts.csv`.
        published: the archive that it came in.
    """

    folder: Path
    published: PublishedFile


def download_100style(
    out: str | Path,
    *,
    record_url: str = RECORD,
    overwrite: bool = False,
    patience: Patience | None = None,
    progress: Progress | None = None,
) -> Downloaded:
    """Fetches 100STYLE and unpacks it; a run after a broken one goes on where that ended.

    Args:
        out: folder for the styles. The archive is kept in `OUT.zip.part` until they are unpacked.
        record_url: address of the record, for a copy of the data set elsewhere.
        overwrite: replace `out` if it is an earlier download.
        patience: how often to try.
        progress: called with "downloading", "verifying" or "unpacking", the bytes done and the bytes in all.

    Raises:
        InputError: if `out` exists (or, with `overwrite`, is something else); if the server cannot be reached, breaks
            off for good or answers with an error; if the record is malformed or leads to another server; if size or
            checksum is wrong; if the archive is refused (see `archive.unpack`) or holds no `Frame_Cuts.csv`; if the
            disk is full.
    """
    out, patience = Path(out).resolve(), patience or Patience()
    _check_output(out, overwrite)
    part = out.with_name(f"{out.name}.zip.part")
    published = read_record(record_url, ARCHIVE, patience)
    fetch(published, part, patience, progress)
    verify(published, part, progress)
    return Downloaded(_unpack_in_place(published, part, out, progress), published)


def _check_output(out: Path, overwrite: bool) -> None:
    if not out.exists():
        return
    refuse_existing(out, overwrite)
    if not (out / ORIGIN).is_file():
        raise InputError(out, "output", "exists and is no download", f"only a folder with {ORIGIN} is replaced")


def find_table(folder: Path) -> Path | None:
    """`Frame_Cuts.csv` in a folder, one of its folders or one of theirs; the outermost one, None if there is none."""
    for pattern in (TABLE, f"*/{TABLE}", f"*/*/{TABLE}"):
        if tables := sorted(folder.glob(pattern)):
            return tables[0]
    return None


def _unpack_in_place(published: PublishedFile, part: Path, out: Path, progress: Progress | None) -> Path:
    """From the verified archive to the folder; the archive is removed, unless the disk was the obstacle."""
    work = out.with_name(f".{out.name}.{os.getpid()}")
    kept = f"the archive is kept in {part}"
    try:
        work.mkdir()
        unpack(part, work, None if progress is None else lambda done, total: progress("unpacking", done, total))
        table = find_table(work)
        if table is None:
            raise ArchiveError(part, TABLE, "absent", "100STYLE comes with this table of frames")
        write_whole(work / ORIGIN, json.dumps(asdict(published), indent=2) + "\n")
        swap_folder(work, out)
    except ArchiveError:
        part.unlink()
        raise
    except InputError as error:
        raise InputError(error.file, error.place, error.value, f"{error.rule}; {kept}") from error
    except OSError as error:
        raise InputError(out, "output", error.strerror or error, f"must be writable; {kept}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    part.unlink()
    return out / table.parent.relative_to(work)
