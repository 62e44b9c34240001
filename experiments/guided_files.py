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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import tyro

from pfnn_jax.errors import InputError

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


@dataclass
class Search:
    """What libFuzzer calls with each file.

    Attributes:
        read: reads a file with everything that takes its kind, and raises only what breaks a rule.
        file: where the bytes are put for it.
        faults: folder of the files that broke a rule.
        found: where rules were broken; each place is kept once.
    """

    read: Callable[[Path], None]
    file: Path
    faults: Path
    found: set[str] = field(default_factory=set)

    def __call__(self, data: bytes) -> None:
        """Reads the bytes as a file, and keeps them if that breaks a rule."""
        self.file.write_bytes(data)
        try:
            self.read(self.file)
        except Exception as error:  # whatever it is, it breaks a rule
            self.note(data, error)

    def note(self, data: bytes, error: Exception) -> None:
        """Keeps a file that broke a rule at a new place."""
        place: Any = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
        if where not in self.found:
            self.found.add(where)
            (self.faults / f"{len(self.found)}{self.file.suffix}").write_bytes(data)
            print(f"fault: {where}: {str(error)[:200]}", flush=True)


def readers(atheris: Any, kind: str) -> list[Callable[[Path], Any]]:
    """Returns the readers of a kind of files, whose branches are counted."""
    with atheris.instrument_imports(include=["pfnn_jax.motion"]):
        from pfnn_jax.motion.bvh import read_bvh
        from pfnn_jax.motion.clip_files import read_clip
        from pfnn_jax.motion.gltf.character import read_character
        from pfnn_jax.motion.gltf.skin import read_mesh
    return [read_bvh] if kind == "bvh" else [lambda path: read_mesh(read_character(path)), read_clip]


def breaks_a_rule(error: InputError) -> bool:
    """Returns whether a file was refused in another way than it should be."""
    from experiments.mutated_files import check_message  # after `readers`: it imports what is counted there

    return check_message(error) != "refused"


def read_by_all(readers: Sequence[Callable[[Path], Any]], path: Path) -> None:
    """Reads a file with each reader, whatever the others say of it; raises what breaks a rule."""
    for reader in readers:
        try:
            reader(path)
        except InputError as error:
            if breaks_a_rule(error):
                raise


def make_folders(out: Path, kind: str) -> tuple[Path, Path, Path]:
    """Makes the folders of the files to begin with, of those that were kept, and of faults."""
    if not (out / "corpus").exists():
        from experiments.mutated_files import make_files  # after `readers`, as above

        make_files(out / "corpus")
    begin, kept, faults = out / "begin", out / "kept", out / "faults"
    for folder in (begin, kept, faults):
        folder.mkdir(parents=True, exist_ok=True)
    for source in (out / "corpus").glob(f"*.{kind}"):
        (begin / source.name).write_bytes(source.read_bytes())
    return begin, kept, faults


def main(config: Config) -> None:
    """Searches, and prints at the end how many files broke a rule; libFuzzer prints how many it has tried."""
    atheris: Any = importlib.import_module("atheris")  # on Linux alone
    read = partial(read_by_all, readers(atheris, config.kind))
    out = config.out.absolute()
    begin, kept, faults = make_folders(out, config.kind)
    limits = [f"-max_total_time={config.seconds}", f"-timeout={SECONDS}", f"-rss_limit_mb={MEBIBYTES}"]
    places = [f"-seed={config.seed}", f"-artifact_prefix={faults}/", str(kept), str(begin)]
    atheris.Setup([sys.argv[0], *limits, *places], Search(read, out / f"file.{config.kind}", faults))
    atheris.Fuzz()


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
