"""``carina doctor``: report on the software and hardware that Carina uses."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
from importlib import resources
from typing import Any

import carina
from carina.cli.console import print_json, print_result
from carina.config import Settings, load_settings
from carina.disk import say_size
from carina.installation import extra_command, install_command, rebuild
from carina.render import Adapter, AdapterMeasurement, Backend, build_info, find_adapters
from carina.render.processor_choice import RECORD_NAME


def gpu_facts(settings: Settings) -> dict[str, Any]:
    """Return the adapters, their measurements, and which may be used, for ``--json``."""
    adapters = find_adapters()
    backend = Backend(settings.backend, record=settings.cache_dir / RECORD_NAME, find=lambda: adapters)
    # The user's choice is made in the details of the status dot.
    by = (
        f"CARINA_BACKEND={settings.backend}"
        if settings.is_backend_forced
        else f"chosen in the window: {settings.backend}"
    )
    return {
        "in_build": adapters is not None,
        "backend": settings.backend,
        "adapters": [_adapter_facts(backend, adapter, chosen_by=by) for adapter in adapters or ()],
    }


def _adapter_facts(backend: Backend, adapter: Adapter, *, chosen_by: str) -> dict[str, Any]:
    measured = [v for v in backend.measurements if (v.adapter, v.driver) == (adapter.name, adapter.driver)]
    chosen, why = _choice_text(backend, adapter, measured, by=chosen_by)
    return {
        "name": adapter.name,
        "api": adapter.api,
        "driver": adapter.driver,
        "kind": adapter.kind,
        "chosen": chosen,
        "why": why,
        "measured": [
            {"shape_zyx": v.shape_zyx, "chosen": v.chosen, "why": v.why, "cpu_ms": v.cpu_ms, "gpu_ms": v.gpu_ms}
            for v in measured
        ],
    }


def _choice_text(
    backend: Backend, adapter: Adapter, measured: list[AdapterMeasurement], *, by: str
) -> tuple[bool, str]:
    """Return whether airway views are rendered by this adapter, and the reason.

    ``by`` names what chose the processor, such as ``CARINA_BACKEND=cpu``.
    """
    if backend.mode == "cpu":
        return False, by
    if backend.mode == "gpu":
        first = backend.adapters()[0] == adapter
        return first, by if first else f"{by} uses only the first adapter"
    if adapter.is_software:
        return (
            False,
            "a software renderer that runs on the CPU and is no faster; for tests only (CARINA_BACKEND=gpu)",
        )
    if not measured:
        return False, "not measured yet; will be measured during the first flight through a case"
    sizes = "; ".join(f"{_size_text(v)}: {v.why}" for v in measured)
    return any(v.chosen for v in measured), sizes


def _size_text(measurement: AdapterMeasurement) -> str:
    nz, ny, nx = measurement.shape_zyx
    return f"{nx} x {ny} x {nz}"


def gpu_lines(facts: dict[str, Any]) -> list[str]:
    """Return the report about the adapters as lines of text."""
    if not facts["in_build"]:
        return ["GPU: not supported by this build (a wheel made by make wheel supports it); rendering on the CPU"]
    if not facts["adapters"]:
        return ["GPU: no adapter found; rendering on the CPU"]
    lines = []
    for adapter in facts["adapters"]:
        state = "used" if adapter["chosen"] else "not used"
        lines.append(f"GPU: {adapter['name']} ({adapter['kind']}, {adapter['api']}; {adapter['driver']})")
        lines.append(f"  {state}: {adapter['why']}")
    return lines


OPTIONAL = {
    "pyserial": ("serial pens and handles", "devices"),
    "cryptography": ("the phone page", "phone"),
    "segno": ("the phone page", "phone"),
    "av": ("fly-through videos (carina fly)", "video"),
    "reportlab": ("reports as PDF", "report"),
    "vtk": ("the reference renderer in benchmarks", "bench"),
    "numba": ("a baseline in benchmarks", "bench"),
    "ray": ("rendering on several machines (Linux)", "cluster"),
    "scipy": ("the reference distance transform in benchmarks", "bench"),
}
NEEDED = ("numpy", "pydicom", "python-gdcm", "starlette", "uvicorn", "websockets", "simplejpeg")


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _cached_cts(settings: Settings) -> dict[str, Any]:
    from carina.volume import VolumeCache  # needs the packages that may be missing

    cache = VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)
    sizes = cache.sizes()
    return {"on": cache.is_on, "num": len(sizes), "num_bytes": sum(size.num_bytes for size in sizes)}


def report(*, as_json: bool) -> int:
    """Print the software and hardware that Carina runs on; return 1 if a required part is missing."""
    core = build_info()
    web_ui = resources.files("carina").joinpath("_web/index.html").is_file()
    settings = load_settings()
    browser = next((name for name in ("chromium", "google-chrome", "firefox") if shutil.which(name)), None)
    gpu = gpu_facts(settings)
    facts: dict[str, Any] = {
        "carina": carina.__version__,
        "core": core,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "renderer": "gpu" if any(adapter["chosen"] for adapter in gpu["adapters"]) else "cpu",
        "gpu": gpu,
        "web_ui": web_ui,
        "browser": browser,
        "packages": {name: _version(name) for name in NEEDED},
        "optional": {name: _version(name) for name in OPTIONAL},
        "cache_dir": str(settings.cache_dir),
    }
    missing = [name for name, version in facts["packages"].items() if version is None]
    cached = None if missing else _cached_cts(settings)
    facts["cached_cts"] = cached
    problems = [f"{name} is missing; install it with: {install_command(name)}" for name in missing]
    if not web_ui:
        problems.append(f"the web UI is not built: {rebuild()}")
    if core["profile"] != "release":
        problems.append(f"the compiled module is a debug build, which renders slowly: {rebuild()}")
    facts["problems"] = problems
    if as_json:
        print_json(facts)
        return 1 if problems else 0
    print_result(f"Carina {facts['carina']} on Python {facts['python']}, {facts['platform']}")
    print_result(f"  renderer: CPU, {core['threads']} threads, {core['simd']} kernels, {core['profile']} build")
    for line in gpu_lines(gpu):
        print_result(f"  {line}")
    print_result(f"  web UI: {'built' if web_ui else 'missing'}; browser: {browser or 'none found on PATH'}")
    for name, version in facts["packages"].items():
        print_result(f"  {name} {version or 'MISSING'}")
    for name, (use, extra) in OPTIONAL.items():
        version = facts["optional"][name]
        print_result(
            f"  {name} {version}" if version else f"  {name}: not installed; for {use}: {extra_command(extra)}"
        )
    if cached is not None:
        off = "" if cached["on"] else " (cache off)"
        print_result(f"  cached CTs: {cached['num']}, {say_size(cached['num_bytes'])}{off}")
    for problem in problems:
        print_result(f"  problem: {problem}")
    if not problems:
        print_result("  nothing is missing")
    return 1 if problems else 0
