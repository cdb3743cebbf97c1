"""Facts about the machine and the software, without which a time means nothing."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from femdeform import info, jit


def machine_facts() -> dict[str, Any]:
    """Return processor, cores, threads, memory [bytes], load before the start, system and versions."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "processor": processor_name(),
        "cores": jit.n_available_cores(),
        "threads": jit.default_threads(),
        "memory": total_memory(),
        "load_average": load,
        "system": f"{platform.system()} {platform.release()}",
        "versions": info.versions(),
    }


def processor_name() -> str:
    """Name of the processor's model, as far as the system tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return " ".join(value.split())
    except OSError:
        pass
    return platform.processor() or platform.machine() or "unknown"


def total_memory() -> int | None:
    """Memory of the machine [bytes], None where it cannot be found."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return None


def available_memory() -> int | None:
    """Memory that programs may still take [bytes], None where it cannot be found."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None


def describe(facts: dict[str, Any]) -> list[str]:
    """Lines of text about the machine, with a warning where it was busy when the benchmark began."""
    versions = facts["versions"]
    wanted = ("femdeform", "python", "numpy", "numba", "scipy", "petsc4py", "mpi4py")
    listed = ", ".join(f"{name} {versions[name]}" for name in wanted if name in versions)
    memory = "" if facts["memory"] is None else f", {facts['memory'] / 2**30:.1f} GiB"
    lines = [
        f"{facts['processor']}, {facts['cores']} cores, {facts['threads']} threads{memory}, {facts['system']}",
        listed,
    ]
    if facts["load_average"] is not None and facts["load_average"] > 0.3:
        lines.append(
            f"The machine was busy before the start (load average {facts['load_average']:.1f}): times may be too long."
        )
    return lines
