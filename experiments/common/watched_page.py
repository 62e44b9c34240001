"""Any command of `pfnn-jax` in a process that notes what its memory holds, to say why it grows.

Run       python -m experiments.common.watched_page FILE play RUN ...
"""

from __future__ import annotations

import ctypes
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

EVERY = 5.0
"""Seconds between two notes."""

MEBIBYTE = 2**20


class MallInfo(ctypes.Structure):
    """What `mallinfo2` of the GNU C library returns."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
    ]


def held() -> dict[str, Any]:
    """Returns how many arrays, compiled programs and blocks of Python live, and the MiB that malloc has given out.

    Not Python's objects: a list of them would hold tuples that are being made, which then fails.
    """
    import jax

    arrays = jax.live_arrays()
    found = {
        "arrays": len(arrays),
        "array_mib": round(sum(array.nbytes for array in arrays) / MEBIBYTE, 1),
        "programs": len(jax.devices()[0].client.live_executables()),
        "blocks": sys.getallocatedblocks(),
    }
    return {**found, **allocated(), "noted": time.time()}


def allocated() -> dict[str, float]:
    """Returns the MiB that malloc has given out, and those that it keeps free; nothing with another C library."""
    read = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if read is None:
        return {}
    read.restype = MallInfo
    info = read()
    used, free = info.uordblks + info.hblkhd, info.fordblks
    return {"malloc_used": round(used / MEBIBYTE, 1), "malloc_free": round(free / MEBIBYTE, 1)}


def note(file: Path) -> None:
    """Replaces the file's content by what is held, again and again."""
    while True:
        time.sleep(EVERY)
        if "jax" in sys.modules:  # the command decides when it is imported
            part = file.with_name(f"{file.name}.part")
            part.write_text(json.dumps(held()))
            part.replace(file)


def main() -> None:
    """Runs the command of the arguments after the file's name."""
    file = Path(sys.argv.pop(1))
    threading.Thread(target=note, args=(file,), name="watch", daemon=True).start()
    from pfnn_jax.cli import main as command

    command()


if __name__ == "__main__":
    main()
