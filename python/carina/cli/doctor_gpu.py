"""Report of ``carina doctor`` about graphics adapters."""

from __future__ import annotations

from typing import Any

from carina.config import Settings
from carina.render import Adapter, AdapterMeasurement, Backend, find_adapters
from carina.render.backend import RECORD_NAME

__all__ = ["gpu_facts", "gpu_lines"]


def gpu_facts(settings: Settings) -> dict[str, Any]:
    """Return the adapters, their measurements, and which may be used, for ``--json``."""
    adapters = find_adapters()
    backend = Backend(settings.backend, record=settings.cache_dir / RECORD_NAME, find=lambda: adapters)
    return {
        "in_build": adapters is not None,
        "backend": settings.backend,
        "adapters": [_adapter_facts(backend, adapter) for adapter in adapters or ()],
    }


def _adapter_facts(backend: Backend, adapter: Adapter) -> dict[str, Any]:
    measured = [v for v in backend.measurements if (v.adapter, v.driver) == (adapter.name, adapter.driver)]
    chosen, why = _choice(backend, adapter, measured)
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


def _choice(backend: Backend, adapter: Adapter, measured: list[AdapterMeasurement]) -> tuple[bool, str]:
    """Return whether airway views are rendered by this adapter, and the reason."""
    if backend.mode == "cpu":
        return False, "CARINA_BACKEND=cpu"
    if backend.mode == "gpu":
        first = backend.adapters()[0] == adapter
        return first, "CARINA_BACKEND=gpu" if first else "CARINA_BACKEND=gpu uses only the first adapter"
    if adapter.is_software:
        return (
            False,
            "a software renderer that runs on the CPU and is no faster; for tests only (CARINA_BACKEND=gpu)",
        )
    if not measured:
        return False, "not measured yet; will be measured during the first flight through a case"
    sizes = "; ".join(f"{_size(v)}: {v.why}" for v in measured)
    return any(v.chosen for v in measured), sizes


def _size(measurement: AdapterMeasurement) -> str:
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
