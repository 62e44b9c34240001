"""Fixtures shared by all tests: where the real data lies, and strict numerics."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

SHARED = Path(__file__).resolve().parents[2] / "shared"

BROWSERS = {"browser", "three"}
"""Fixtures that start one."""

MAX_MAPS = 15_000
"""Blocks of memory that a test process may keep mapped from one module to the next."""

# Read by JAX when it is first imported, so that tests of `motion` need not import it: broadcasting between arrays of
# different rank is an error unless written out.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
# Tests compile much and compute little: without LLVM's optimisations they take half the time, and with XLA's older
# emitters, without threads, again two thirds.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1")
# What one worker or an earlier run has compiled is read from disk; for what compiles sooner that saves nothing.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).resolve().parents[1] / ".jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.05")
# Where XLA reads it, it can write thousands of letters about the processor into the output of programs under test.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

# Tracing makes many objects and few cycles: with Python's own thresholds a tenth of the time is spent looking for them.
gc.set_threshold(50_000, 20, 100)

# A shell lets what it starts in the background ignore interrupts, and programs inherit that; tests send interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The first example of a property compiles, which takes longer than hypothesis allows. On continuous integration the
# same examples are drawn every time.
settings.register_profile("pfnn_jax", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("pfnn_jax")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks tests that need a browser as slow: it draws in software, and takes the processors from other tests."""
    for item in items:
        if item.get_closest_marker("browser") or BROWSERS & set(getattr(item, "fixturenames", ())):
            item.add_marker("slow")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips tests marked `gpu` where JAX finds no accelerator."""
    if item.get_closest_marker("gpu"):
        import jax

        if jax.default_backend() == "cpu":
            pytest.skip("JAX finds no accelerator on this machine")


@pytest.fixture(scope="session", autouse=True)
def data_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keeps the base network and its styles out of the user's own data folder, in programs that tests start too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data_home")))
        yield


@pytest.fixture(scope="module", autouse=True)
def release_compiled_functions() -> Iterator[None]:
    """Drops compiled functions after a test module where the process holds many.

    Each maps several blocks of memory, of which Linux allows a process 65,530 by default; one that needs more dies in
    the compiler.
    """
    yield
    jax, maps = sys.modules.get("jax"), Path("/proc/self/maps")
    if jax and maps.exists() and len(maps.read_text().splitlines()) > MAX_MAPS:
        jax.clear_caches()
        gc.collect()


def _folder(variable: str, default: Path) -> Path:
    folder = Path(os.environ.get(variable, default))
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set {variable} to the folder of real data")
    return folder


@pytest.fixture(scope="session")
def mocap() -> Path:
    """Folder of real motion capture; skips where it is absent."""
    return _folder("PFNN_JAX_MOCAP", SHARED / "mocap")


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of the authors' weights and golden files; skips where it is absent."""
    return _folder("PFNN_JAX_REFERENCE", SHARED / "reference")


@pytest.fixture(scope="session")
def characters() -> Path:
    """Folder of rigged characters; skips where it is absent."""
    return _folder("PFNN_JAX_CHARACTERS", SHARED / "characters")


@pytest.fixture(scope="session")
def lpn_run(reference, tmp_path_factory):
    """The authors' local-phase network with its 100 styles, imported once per worker."""
    from pfnn_jax.interop.released.mason2022 import import_released_lpn

    return import_released_lpn(reference / "lpn", tmp_path_factory.mktemp("released") / "lpn")
