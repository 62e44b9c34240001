"""Does any damaged or hostile file break a reader? Reads files that were changed at random.

Question  Readers of foreign files (BVH, glTF, weights, arrays, JSON) must read a file or refuse it with an `InputError`
          of one line: no other exception, no hang over 10 s, no more than 2 GiB of memory.
Data      a corpus of small files made here (procedural walks, an own character, arrays and notes of a tiny run), of
          which each is changed one to four times: bits, blocks, numbers, lines, towers of joints, values of JSON.
          Number N is always the same file.
Run       python -m experiments.mutated_files --out runs/mutated --count 10000 --seconds 170
          goes on where the last call has stopped. A file that breaks a rule is kept in OUT/faults, with its number.
"""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import tyro

from experiments.common.mutations import mutated
from pfnn_jax.cli.style_show import print_card
from pfnn_jax.errors import InputError
from pfnn_jax.interop.released.files import read_array, read_description
from pfnn_jax.io.files import read_json, write_json
from pfnn_jax.io.npz import as_floats, read_arrays
from pfnn_jax.io.tensors import read_tensors, write_tensors
from pfnn_jax.io.text_rows import read_rows
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.datasets.clip_rows import load_for_skeleton
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.gltf.write import glb_bytes
from pfnn_jax.motion.humanoid.overrides import choose_joints, read_overrides_file
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from pfnn_jax.workflows.style_card import SKELETON, StyleCard, card_from_metadata

SECONDS = 10
"""A reader that takes longer hangs: of processor time, since the machine may be busy."""

MEMORY = 2 * 2**30
"""Bytes by which the address space of the reading process may grow."""

TINY: dict[str, Any] = {"hidden": 8, "steps": 2, "batch_size": 16, "steps_per_dispatch": 2}
"""Settings of the run of the corpus."""


@dataclass(frozen=True)
class Config:
    """How much is tried.

    Attributes:
        out: folder of the corpus, the counts and the faults.
        count: number of the last file.
        seconds: after which this call stops; the next one goes on.
        only: number of a single file to read again, whose traceback is printed.
    """

    out: Path
    count: int = 10_000
    seconds: float = 170.0
    only: int | None = None


class Target(NamedTuple):
    """A file that is changed.

    Attributes:
        file: in the corpus.
        kind: of changes, see `mutations`.
        share: of all files.
        read: reads it, in its folder.
    """

    file: str
    kind: str
    share: float
    read: Callable[[Path], Any]


class Hang(BaseException):
    """Raised in a reader that takes too long; no `except Exception` catches it."""


def read_motion(file: Path) -> None:
    """Reads a clip as `few-shot` does: labelled, on another skeleton. A glTF file is also read as a character."""
    if file.suffix != ".bvh":
        try:
            read_mesh(read_character(file))
        except InputError as error:
            check_message(error)
    read_clip(file)
    load_for_skeleton(ClipFile(file, "walk"), mason2018(synthetic_skeleton().num_joints), synthetic_skeleton())


def read_archive(file: Path) -> None:
    """Reads arrays as `predict` and `import-released` do."""
    for name, values in read_arrays(file, ("x", "phase"), "must be an archive").items():
        as_floats(file, name, values)


def read_shared_style(file: Path) -> None:
    """Reads a shared style as `style import` does, up to its card, and shows the card."""
    card = card_from_metadata(read_tensors(file)[1], file)
    with contextlib.redirect_stdout(io.StringIO()):
        print_card(file, card)


def read_run(file: Path) -> None:
    """Loads the run that a file is part of, with its styles and its state of training."""
    from pfnn_jax.run import load_run, load_style, load_train_state  # JAX, which the other readers do not need
    from pfnn_jax.training.config import PretrainConfig
    from pfnn_jax.training.pretraining import init_state

    path = next(parent for parent in file.parents if parent.name == "run")
    run = load_run(path)
    for name in run.config.styles:
        load_style(run, name)
    load_train_state(path, init_state(PretrainConfig(**TINY), run.layout, len(run.config.styles)))


def read_data(file: Path) -> None:
    """Opens the dataset that a file is part of, and reads all of its arrays."""
    dataset = load_dataset(next(parent for parent in file.parents if parent.name == "data"))
    for style in dataset.styles:
        for array in dataset.arrays(style):
            array.tobytes()


TARGETS = (
    Target("walk.bvh", "bvh", 0.3, read_motion),
    Target("three.bvh", "bvh", 0.1, read_bvh),
    Target("body.glb", "glb", 0.3, read_motion),
    Target("body.gltf", "json", 0.05, read_motion),
    Target("rows.npz", "binary", 0.03, read_archive),
    Target("packed.npz", "binary", 0.03, read_archive),
    Target("style.safetensors", "safetensors", 0.02, read_shared_style),
    Target("roles.json", "json", 0.02, lambda file: choose_joints(read_overrides_file(file), ("Hips", "Head"), file)),
    Target("skeleton.json", "json", 0.03, lambda file: skeleton_from_json(read_json(file, "a skeleton"), file)),
    Target("walk.phase", "text", 0.01, lambda file: read_rows(file, 1)),
    Target("weights.bin", "binary", 0.01, lambda file: read_array(file, (8, 16))),
    Target("description.json", "json", 0.01, lambda file: read_description(file.parent, "pfnn2017")),
    Target("run/config.json", "json", 0.006, read_run),
    Target("run/styles/old/style.json", "json", 0.003, read_run),
    Target("run/shared/shared.json", "json", 0.002, read_run),
    Target("run/shared/files.json", "json", 0.002, read_run),
    Target("run/shared/arrays.json", "json", 0.002, read_run),
    Target("run/normaliser/x_mean.npy", "binary", 0.003, read_run),
    Target("run/shared/parameters/**/*", "binary", 0.004, read_run),
    Target("data/dataset.json", "json", 0.02, read_data),
    Target("data/old/x.npy", "binary", 0.01, read_data),
    Target("data/old/windows.npy", "binary", 0.005, read_data),
)


def make_corpus(folder: Path) -> None:
    """Writes the files that are changed; all are small and made here."""
    from pfnn_jax.training.config import PretrainConfig
    from pfnn_jax.workflows.pretrain import pretrain_run

    make_files(folder)
    takes = [clip for style in ("neutral", "old") for clip in synthetic_clips(style, 2.0)]
    pretrain_run(prepare(takes, folder / "data", PrepareConfig()), folder / "run", PretrainConfig(**TINY))


def make_files(folder: Path) -> None:
    """Writes the files of the corpus that stand alone."""
    from pfnn_jax.viewer.body.grow import grow_body

    folder.mkdir(parents=True)
    walk = synthesise("old", np.zeros(90), np.full(90, 1.0), seed=1)[0]
    write_bvh(folder / "walk.bvh", walk)
    write_bvh(folder / "three.bvh", synthesise("neutral", np.zeros(3), np.full(3, 1.0), seed=2)[0])
    body = glb_bytes(walk.skeleton, grow_body(walk.skeleton), {"walk": walk})
    (folder / "body.glb").write_bytes(body)
    write_json(folder / "skeleton.json", skeleton_to_json(walk.skeleton))
    write_json(folder / "roles.json", {"hips": "Hips", "head": "Head"})
    (folder / "body.gltf").write_bytes(as_gltf(body))
    rows = {"x": np.ones((9, 12), np.float32), "phase": np.zeros(9)}
    np.savez(folder / "rows.npz", **rows)
    np.savez_compressed(folder / "packed.npz", **rows)
    (folder / "walk.phase").write_text("0.25\n" * 90)
    np.ones((8, 16), np.float32).tofile(folder / "weights.bin")
    network = {"network": {}, "styles": [], "loop": {}, "layout": {"name": "pfnn2017"}, "format": "bins"}
    write_json(folder / "description.json", {**network, "skeleton": skeleton_to_json(walk.skeleton)})
    write_tensors(
        folder / "style.safetensors", {"gamma": np.ones((4, 8), np.float32)}, metadata_of_style(walk.skeleton)
    )


def metadata_of_style(skeleton: Skeleton) -> dict[str, str]:
    """Returns the card of a style, with every kind of entry."""
    entries = skeleton_to_json(skeleton)
    joints = {key: entries[key] for key in SKELETON}
    info = {"frames": 90, "speed": 1.0, "held_out_error": 0.4, "notes": ["a note"], "warnings": ["a warning"]}
    adapter, network = AdapterConfig("film"), "0" * 64
    card = StyleCard("old", "mason2018", adapter, network, network, joints, "old.bvh", "CC BY 4.0", info)
    return card.to_metadata()


def as_gltf(body: bytes) -> bytes:
    """Returns a GLB file as JSON with its buffer in it."""
    import base64

    length = int.from_bytes(body[12:16], "little")
    data, binary = json.loads(body[20 : 20 + length]), body[28 + length :]
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    return json.dumps({**data, "buffers": [{"byteLength": len(binary), "uri": uri}]}).encode()


@functools.cache
def targets_in(corpus: Path) -> tuple[Target, ...]:
    """Returns the targets whose files a corpus has."""
    return tuple(target for target in TARGETS if any(corpus.glob(target.file)))


def changed(corpus: Path, number: int) -> tuple[Target, Path, bytes]:
    """Returns the target of a number, its file in the corpus, and what is in it after the change."""
    random = Random(number)
    targets = targets_in(corpus)
    target = random.choices(targets, [target.share for target in targets])[0]
    file = random.choice(sorted(path for path in corpus.glob(target.file) if path.is_file()))
    return target, file, mutated(file.read_bytes(), target.kind, random)


def attempt(target: Target, file: Path) -> str:
    """Returns `read`, `refused`, or what is wrong: an exception and where it comes from."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    faulthandler.dump_traceback_later(30 * SECONDS, exit=True)  # for what hangs outside Python
    try:
        target.read(file)
        return "read"
    except InputError as error:
        return check_message(error)
    except (Exception, Hang) as error:
        where = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in where if "pfnn_jax" in frame.filename] or where
        place = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
        return f"{type(error).__name__} at {place}: {str(error)[:80]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()


def check_message(error: InputError) -> str:
    """Returns `refused`, or that a message is not one short line."""
    text = str(error)
    return "refused" if len(text.splitlines()) == 1 and len(text) < 1000 else f"message of {len(text)} characters"


def read_many(out: Path, first: int, config: Config) -> None:
    """Reads files from a number on, in this process, and notes each result as a line of JSON."""
    limit_memory()
    corpus, work, began = out / "corpus", out / "work", time.monotonic()
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(corpus, work)
    with (out / "results.jsonl").open("a") as results:
        for number in range(first, config.count):
            if time.monotonic() - began > config.seconds:
                break
            (out / "number").write_text(str(number))
            target, original, data = changed(corpus, number)
            file = work / original.relative_to(corpus)
            file.write_bytes(data)
            started = time.process_time()
            found = attempt(target, file)
            line = {"number": number, "file": target.file, "found": found, "seconds": time.process_time() - started}
            results.write(json.dumps(line) + "\n")
            results.flush()
            if found not in ("read", "refused"):
                keep(out, number, file.name, data)
            shutil.copyfile(original, file)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of the reading process: {peak:.0f} MiB")


def limit_memory() -> None:
    """Lets the address space grow by `MEMORY`, and turns warnings into errors and the timer into hangs."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    size = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    warnings.simplefilter("error")

    def hang(number: int, frame: Any) -> None:
        raise Hang(f"after {SECONDS} s")

    signal.signal(signal.SIGPROF, hang)


def keep(out: Path, number: int, name: str, data: bytes) -> None:
    """Keeps a file that breaks a rule."""
    (out / "faults").mkdir(exist_ok=True)
    (out / "faults" / f"{number}_{name}").write_bytes(data)


def main(config: Config) -> dict[str, Any]:
    """Reads files until the number or the time is reached, and prints what was found."""
    out, began = config.out, time.monotonic()
    if not (out / "corpus").exists():
        make_corpus(out / "corpus.new")
        (out / "corpus.new").rename(out / "corpus")
    results = out / "results.jsonl"
    while (left := config.seconds - (time.monotonic() - began)) > 1:
        first = num_done(results)
        if first >= config.count:
            break
        words = [sys.executable, "-m", "experiments.mutated_files", "--out", str(out), "--count", str(config.count)]
        code = subprocess.run([*words, "--seconds", str(left)], env={**os.environ, CHILD: str(first)}).returncode
        if code:  # killed, or ended by `faulthandler`
            number = int((out / "number").read_text())
            target, file, data = changed(out / "corpus", number)
            keep(out, number, file.name, data)
            line = {"number": number, "file": target.file, "found": f"exit code {code}", "seconds": 0.0}
            with results.open("a") as stream:
                stream.write(json.dumps(line) + "\n")
    return summary(results)


CHILD = "PFNN_JAX_MUTATED_FIRST"
"""Environment variable that tells a process to read files itself, from which number on."""


def num_done(results: Path) -> int:
    return len(results.read_text().splitlines()) if results.exists() else 0


def summary(results: Path) -> dict[str, Any]:
    """Prints and returns how many files were read, refused, and broke a rule."""
    lines = [json.loads(line) for line in results.read_text().splitlines()]
    counts = Counter(line["found"] for line in lines)
    slowest = max(line["seconds"] for line in lines)
    faults = {found: count for found, count in counts.items() if found not in ("read", "refused")}
    print(f"{len(lines)} files: {counts['read']} read, {counts['refused']} refused, {sum(faults.values())} faults")
    print(f"slowest: {slowest:.1f} s")
    for found, count in sorted(faults.items(), key=lambda item: -item[1]):
        numbers = [line["number"] for line in lines if line["found"] == found][:3]
        print(f"{count:5d}  {found}  {numbers}")
    return {"files": len(lines), "counts": dict(counts), "slowest": slowest}


def read_again(out: Path, number: int) -> None:
    """Reads one changed file with the traceback of its error."""
    target, original, data = changed(out / "corpus", number)
    shutil.rmtree(out / "again", ignore_errors=True)
    shutil.copytree(out / "corpus", out / "again")
    file = out / "again" / original.relative_to(out / "corpus")
    file.write_bytes(data)
    limit_memory()
    target.read(file)


if __name__ == "__main__":
    options = tyro.cli(Config, description=__doc__)
    if CHILD in os.environ:
        read_many(options.out, int(os.environ[CHILD]), options)
    elif options.only is not None:
        read_again(options.out, options.only)
    else:
        main(options)
