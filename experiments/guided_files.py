"""Does a search guided by coverage find a file that breaks a reader, where changes at random found none?

Question  as `experiments/mutated_files.py`: a BVH or glTF file is read, or refused with an `InputError` of one line.
Data      the small BVH and GLB files of that experiment, from which the search begins.
Method    libFuzzer, driven by atheris (`pip install atheris`, which the project does not need), changes files and keeps
          those that reach new branches of `pfnn_jax.motion`. 10 s and 2 GiB for each file. What breaks a rule is kept
          in OUT/faults, and what was tried in OUT/kept.
Run       python -m experiments.guided_files --out OUT --kind bvh --seconds 600, and with `--kind glb`
"""

from __future__ import annotations

import importlib
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

SECONDS, MEBIBYTES = 10, 2048
"""A reader that takes longer hangs; a process that holds more has read a file that states too much."""


@dataclass(frozen=True)
class Config:
    """What is searched, and how long.

    Attributes:
        out: folder of the files that are kept.
        kind: of files.
        seconds: after which the search ends.
        seed: of the search.
    """

    out: Path
    kind: Literal["bvh", "glb"]
    seconds: int = 600
    seed: int = 1


def main(config: Config) -> None:
    """Searches, and prints at the end how many files broke a rule; libFuzzer prints how many it has tried."""
    atheris: Any = importlib.import_module("atheris")  # on Linux alone

    # Branches are counted in what is imported within.
    with atheris.instrument_imports(include=["pfnn_jax.motion"]):
        from pfnn_jax.motion.bvh import read_bvh
        from pfnn_jax.motion.clip_files import read_clip
        from pfnn_jax.motion.gltf.character import read_character
        from pfnn_jax.motion.gltf.skin import read_mesh
    from experiments.mutated_files import check_message, make_files
    from pfnn_jax.errors import InputError

    out = config.out.absolute()
    if not (out / "corpus").exists():
        make_files(out / "corpus")
    begin, kept, faults = out / "begin", out / "kept", out / "faults"
    for folder in (begin, kept, faults):
        folder.mkdir(parents=True, exist_ok=True)
    for source in (out / "corpus").glob(f"*.{config.kind}"):
        (begin / source.name).write_bytes(source.read_bytes())
    file, found = out / f"file.{config.kind}", set()

    def read_all(path: Path) -> None:
        if config.kind == "bvh":
            read_bvh(path)
            return
        for reader in (lambda: read_mesh(read_character(path)), lambda: read_clip(path)):
            try:
                reader()
            except InputError as error:
                if check_message(error) != "refused":
                    raise RuntimeError(check_message(error)) from error

    def read(data: bytes) -> None:
        file.write_bytes(data)
        try:
            read_all(file)
        except InputError as error:
            if check_message(error) != "refused":
                note(data, error)
        except Exception as error:
            note(data, error)

    def note(data: bytes, error: Exception) -> None:
        place: Any = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
        if where not in found:
            found.add(where)
            (faults / f"{len(found)}.{config.kind}").write_bytes(data)
            print(f"fault: {where}: {str(error)[:200]}", flush=True)

    limits = [f"-max_total_time={config.seconds}", f"-timeout={SECONDS}", f"-rss_limit_mb={MEBIBYTES}"]
    atheris.Setup(
        [sys.argv[0], *limits, f"-seed={config.seed}", f"-artifact_prefix={faults}/", str(kept), str(begin)], read
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
