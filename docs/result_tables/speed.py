"""Tables of times; under each the machine."""

from typing import Any

from result_tables.common import report, short, table


def _on(*names: str) -> str:
    """Machine and threads of reports, and whether they are of one machine.

    Raises
    ------
    ValueError
        If they are not.
    """
    machines = {str(report(name)["machine"]) for name in names}
    if len(machines) > 1:
        raise ValueError(f"{', '.join(names)}: measured on different machines or versions")
    found: dict[str, Any] = report(names[0])["machine"]
    return (
        f"Measured on {found['processor']}, {found['cores']} cores, {found['system']}, Python "
        f"{found['python']}, torch {found['torch']}.\n"
    )


def live_speed() -> str:
    """Times of live frames, and of the whole command."""
    speed, run = report("live-speed")["backends"], report("live-run")
    both = speed["torch"], speed["onnx"]
    voices = both[0]["voices"]
    frames = [f"{short(s['median_ms'], 1)}, {short(s['p99_ms'], 1)} ms" for s in both]
    rows = [
        ["computing of a frame, one voice in blocks of 10 ms: median, p99", "8 ms p99", *frames],
        [
            f"{voices} voices in one call, share of a core",
            "1",
            *(short(s["cores_of_the_voices"], 2) for s in both),
        ],
    ]
    spent, threads = [row["cores"] for row in run["periods"]], run["threads"]
    skipped = sum(row["skipped"] for row in run["periods"])
    whole = [
        ["frame's sound to its datagram, beyond the look-ahead: median", "30 ms", _ms(run)],
        ["the same, largest p99 of half a minute", "", _ms(run, "p99_")],
        ["frames skipped", "0", str(skipped)],
        [f"share of a core (threads of torch: {threads})", "", short(sum(spent) / len(spent), 2)],
        ["growth of memory", "", f"{run['memory_growth_mb']:.0f} MB"],
    ]
    first = table([["", "must", "torch", "ONNX Runtime"], *rows])
    minutes = f"{run['minutes']:g} minutes of `deitalk live --mic`"
    second = table([[minutes, "must", "measured"], *whole])
    return f"{first}\n{second}\n{_on('live-speed', 'live-run')}"


def _ms(run: dict[str, Any], kind: str = "") -> str:
    return f"{run[f'{kind}beyond_look_ahead_ms']:.0f} ms"


def batch_rate() -> str:
    """Rate of a batch beside its network."""
    found = report("batch-rate")
    share = found["share_of_the_network"]
    rows = [
        ["network alone, a line at a time", f"{found['network_ms']:.0f} ms of a core a line"],
        ["batch, files and journal included", f"{found['processor_ms']:.0f} ms of a core a line"],
        ["batch, wall time", f"{found['wall_ms']:.0f} ms a line"],
        ["share of twice the rate of the network alone", f"{100 * share:.0f} %"],
        ["memory of the largest process", f"{found['largest_process_mb']:.0f} MB"],
    ]
    title = (
        f"{found['lines']} lines of {found['seconds_of_a_line']:.1f} s on average, "
        f"{found['workers']} processes"
    )
    return f"{table([[title, ''], *rows])}\n{_on('batch-rate')}"


def cold_start() -> str:
    """Time of whole processes as multiples of ``import torch``."""
    found = report("cold-start")
    rows = [
        [f"`{name}`"] + [short(row[f"{kind}_of_import_torch"], 2) for kind in ("processor", "wall")]
        for name, row in found["commands"].items()
        if name != "import torch"
    ]
    title = f"a recording of 9 s, medians of {found['runs']}; times of `import torch`"
    return f"{table([[title, 'processor time', 'wall time'], *rows])}\n{_on('cold-start')}"


def onnx_sizes() -> str:
    """Size, time and error in int8."""
    found = report("onnx-sizes")
    rows = [
        [
            name,
            f"{row['megabytes']:.1f}",
            short(row["processor_seconds_per_second"], 4),
            *(short(row[key], digits) for key, digits in ERRORS.items()),
        ]
        for name, row in found["kinds"].items()
    ]
    heads = ["", "MB", "processor s per s of sound", "largest", "rms", "intensity"]
    return f"{table([heads, *rows])}\n{_on('onnx-sizes')}"


def device() -> str:
    """What a GPU does."""
    found = report("device")
    rows = []
    for name, values in found["measures"].items():
        cells = [f"{values['rate']:,.0f}" if "rate" in values else ""]
        if "median_ms" in values:
            cells = [f"{values['median_ms']:.0f}, {values['p95_ms']:.0f} ms a message"]
        off = f"{values['largest']:.1g}" if "largest" in values else ""
        rows.append([name, *cells, off])
    heads = [found["device"], "times real time; median, p95", "largest error"]
    return f"{table([heads, *rows])}\n{_on('device')}"


ERRORS = {"largest": 3, "rms": 4, "intensity": 3}


def service_load() -> str:
    """Times of the service."""
    found = report("service-load")
    start, one = found["start"], found["one_client_ms"]
    rows = [
        [
            "start: first answer; first worker ready [processor time]",
            f"{start['answers_seconds']:.1f} s; {start['ready_seconds']:.1f} s "
            f"[{start['processor_seconds']:.1f} s]",
        ],
        [
            "10 s of speech to JSON, one client, median [processor time]",
            f"{one['median']:.0f} ms [{one['processors']:.0f} ms]",
        ],
        [
            "the library alone, in turns with it",
            f"{one['library_median']:.0f} ms [{one['library_processors']:.0f} ms]",
        ],
    ]
    for clients, row in found["clients"].items():
        text = f"{clients} clients, p95 as a multiple of one's"
        rows.append([text, short(row["p95_of_one"], 1)])
    return f"{table([['`python -m tests.api.load`', ''], *rows])}\n{_on('service-load')}"


MODELS_OF_TABLE_4 = ("Karras-style", "VOCA-style", "SDFA")


def table_4() -> str:
    """SDFA's Table 4 on this machine, with one and two threads, beside the published times."""
    both = [report(f"mesh-speed-{threads}") for threads in (1, 2)]
    published = both[0]["published"]
    heads = [h for name in MODELS_OF_TABLE_4 for h in (f"{name} 1 / 2", "published")]
    rows = []
    for place, stage in enumerate(both[0]["milliseconds"]["SDFA"]):
        cells = []
        for name in MODELS_OF_TABLE_4:
            ours = [_known(r["milliseconds"][name][stage]) for r in both]
            cells += [" / ".join(dict.fromkeys(ours)) if ours[0] == "–" else " / ".join(ours)]
            cells += [_known(published[name][place])]
        rows.append([stage, *cells])
    sizes = []
    for name in MODELS_OF_TABLE_4:
        size = both[0]["megabytes"][name]
        sizes += [f"{size['trained']:.1f} + {size['fixed']:.1f}", ""]
    rows.append(["MiB, trained + fixed", *sizes])
    main = table([[f"ms for {both[0]['frames']} frames", *heads], *rows])
    return f"{main}\n{_on('mesh-speed-1', 'mesh-speed-2')}"


def _known(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.1f}"
