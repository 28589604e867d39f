"""`evaluate --speed`: time of the stages, real-time factor and memory on this machine."""

import os
from typing import Any

from deitalk.cli.console import bar, console, emit, emit_json


def measure(
    model: str,
    seconds: float,
    threads: int,
    repeats: int,
    *,
    memory: bool,
    mesh: bool,
    as_json: bool,
) -> None:
    """Measure speed and memory on this machine."""
    threads = min(threads, os.cpu_count() or 1)
    if mesh:
        _table_4(threads, repeats, as_json=as_json)
        return
    from deitalk.models.folder import describe_model
    from deitalk.research.evaluation import benchmark_curves as measures

    lengths = (60.0, 600.0, 3600.0) if memory else ()
    result: dict[str, Any] = {"model": model, "sha256": describe_model(model)["sha256"]}
    with bar("measuring") as progress:
        total = 2 + len(lengths)
        result["machine"] = measures.machine()
        result["clip"] = measures.measure(model, seconds, threads, repeats)
        progress(1 / total)
        result["table_4_clip"] = measures.measure(model, measures.TABLE_4_SECONDS, threads, repeats)
        progress(2 / total)
        result["memory"] = []
        for i, length in enumerate(lengths):
            result["memory"].append(measures.peak_memory(model, length))
            progress((3 + i) / total)
    if as_json:
        emit_json(result)
        return
    for name in ("clip", "table_4_clip"):
        _print_clip(result[name])
    emit(
        "SDFA Table 4 for its 5.1 s clip, on an i7-8700K, milliseconds: "
        + ", ".join(f"{k} {v:g}" for k, v in measures.TABLE_4_MILLISECONDS.items())
    )
    for row in result["memory"]:
        emit(
            f"{row['clip_seconds']:g} s of audio: peak {row['megabytes']:.0f} MB, "
            f"{row['wall_seconds']:.1f} s"
        )


def _table_4(threads: int, repeats: int, *, as_json: bool) -> None:
    with console().status("measuring"):
        from deitalk.research.evaluation import benchmark_mesh as tables
        from deitalk.research.evaluation.benchmark_curves import machine

        report = {"machine": machine(), **tables.table_4(threads, repeats)}
    if as_json:
        emit_json(report)
    else:
        emit(tables.as_markdown(report))


def _print_clip(clip: dict[str, Any]) -> None:
    stages = ", ".join(f"{name} {1000 * lap:.0f}" for name, lap in clip["stages"].items())
    emit(
        f"{clip['clip_seconds']:g} s clip, {clip['threads']} thread(s): "
        f"RTF {clip['rtf_cpu']:.4f} CPU, {clip['rtf_wall']:.4f} wall; stages in ms: {stages}"
    )
