"""Runs a command and measures what it and all processes that it starts take: time, memory, and bytes read from disk."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

PROC = Path("/proc")
KIBIBYTE = 1024


@dataclass
class Usage:
    """What a command took, together with the processes that it started.

    Memory is the proportional set size: pages that several processes share count once. It includes pages of mapped
    files, which the system takes back when it needs memory; `peak_own_bytes` leaves those out.

    Attributes:
        wall_seconds: from start to end.
        processor_seconds: of user and system.
        peak_bytes: highest sum over all processes at one moment.
        peak_own_bytes: the same without pages of files.
        peaks: the highest memory of each process that was seen, the largest first.
        disk_bytes: read from storage, that is, not found in the system's cache.
        exit_status: of the command.
    """

    wall_seconds: float = 0.0
    processor_seconds: float = 0.0
    peak_bytes: int = 0
    peak_own_bytes: int = 0
    peaks: list[int] = field(default_factory=list)
    disk_bytes: int = 0
    exit_status: int = 0


def measure_command(command: Sequence[str], log: Path, interval: float = 1.0) -> Usage:
    """Runs a command to its end, and looks at its processes at intervals; needs the `/proc` of Linux.

    Args:
        command: program and arguments.
        log: file that its output is appended to.
        interval: seconds between two looks.
    """
    usage, peaks, read = Usage(), {}, {}
    started = time.perf_counter()
    with log.open("a") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    while True:
        found = {pid: memory for pid in process_tree(process.pid) if (memory := memory_of(pid)) is not None}
        usage.peak_bytes = max(usage.peak_bytes, sum(whole for whole, _ in found.values()))
        usage.peak_own_bytes = max(usage.peak_own_bytes, sum(own for _, own in found.values()))
        for pid, (whole, _) in found.items():
            peaks[pid] = max(peaks.get(pid, 0), whole)
            read[pid] = max(read.get(pid, 0), disk_bytes(pid))
        pid, status, resources = os.wait4(process.pid, os.WNOHANG)
        if pid:
            break
        time.sleep(interval)
    usage.wall_seconds = time.perf_counter() - started
    usage.processor_seconds = resources.ru_utime + resources.ru_stime  # those of ended children are in it
    usage.peaks, usage.disk_bytes = sorted(peaks.values(), reverse=True), sum(read.values())
    usage.exit_status = process.returncode = os.waitstatus_to_exitcode(status)
    return usage


def process_tree(root: int) -> Iterator[int]:
    """Yields a process and all below it."""
    children: dict[int, list[int]] = {}
    for entry in PROC.iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry.name))
    waiting = [root]
    while waiting:
        yield (pid := waiting.pop())
        waiting += children.get(pid, [])


def memory_of(pid: int) -> tuple[int, int] | None:
    """Returns the proportional set size of a process in bytes, and that part of it that is not of files.

    None for a process that has ended.
    """
    try:
        lines = (PROC / str(pid) / "smaps_rollup").read_text().splitlines()[1:]
    except OSError:
        return None
    sizes = {name: KIBIBYTE * int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines)}
    return sizes["Pss"], sizes["Pss"] - sizes["Pss_File"]


def disk_bytes(pid: int) -> int:
    """Returns the bytes that a process has read from storage; 0 for one that has ended."""
    try:
        lines = (PROC / str(pid) / "io").read_text().splitlines()
    except OSError:
        return 0
    return next(int(line.split()[1]) for line in lines if line.startswith("read_bytes"))
