"""Memory of work in background threads."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

LEFT = 40.0
"""MiB that may be left of the 160 that eight threads have allocated and freed: what threads and Python itself take."""

PROGRAM = """
import threading
import psutil
from pfnn_jax.viewer.page.background import release_memory, share_heap

share_heap()
b"x" * 30_000_000  # freed: from now on malloc keeps up to twice as much at the end of a heap
together = threading.Barrier(8)

def work():
    held = [b"x" * 100_000 for _ in range(200)]
    together.wait()
    held.clear()
    together.wait()

before = psutil.Process().memory_info().rss
threads = [threading.Thread(target=work) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
release_memory()
print((psutil.Process().memory_info().rss - before) / 2**20)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of the GNU C library alone")
def test_memory_that_threads_have_freed_is_returned():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert float(done.stdout) < LEFT, "as much as 150 without `share_heap`"
