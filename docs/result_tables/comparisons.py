"""Tables of trainings beside one another: parts of DEITalk, other networks."""

from result_tables.common import SOURCES, Group, report, short, table

METRICS = {
    "lpe": ("LPE / 1000", 1000, 1),
    "epe": ("EPE / 1000", 1000, 2),
    "bilabial_window_auc": ("bilabial AUC", 1, 3),
    "bilabial_hits_at_5_percent": ("bilabials found", 1, 2),
    "jaw_r": ("jaw r", 1, 3),
    "articulation_r": ("mean r", 1, 3),
    "intensity_rho": ("intensity, rank correlation", 1, 2),
    "jerk_per_speed": ("jerk / speed", 1, 0),
}
"""Title, factor and digits."""

SYSTEMS = {
    "deitalk": "DEITalk",
    "faceformer": "FaceFormer-style",
    "emotalk": "EmoTalk-style, emotion of the voice",
    "emotalk_labelled": "EmoTalk-style, emotion given",
}


def comparison() -> str:
    """DEITalk beside other networks, without the rules after them (DEITalk Table 1)."""
    found = report("comparison")
    rows = [
        [shown, *(spread(found[system]["network"]["librispeech"], m) for m in METRICS)]
        for system, shown in SYSTEMS.items()
    ]
    return table([["LibriSpeech", *(head for head, _, _ in METRICS.values())], *rows])


def spread(
    scores: dict[str, Group], metric: str, metrics: dict[str, tuple[str, int, int]] = METRICS
) -> str:
    """Mean and standard deviation of the seeds."""
    (_, factor, digits), score = metrics[metric], scores[metric]
    if not score["n"]:
        return "–"
    mean = short(factor * score["mean"], digits)
    return mean if score["n"] < 2 else f"{mean} ± {short(factor * score['sd'], digits)}"


PARTS = {
    "no_dei": ("DEI", {"lpe": "+36 %", "epe": "+213 %"}),
    "no_dpe": ("DPE", {"lpe": "+16 %", "epe": "+9 %"}),
    "no_velocity": ("velocity loss", {"lpe": "+130 %", "epe": "+37 %"}),
    "no_classification": ("classification loss", {"lpe": "+12 %", "epe": "+19 %"}),
}
"""Parts that are left out, and what the paper's Table 3 has for it."""
CHANGES = {"lpe": "LPE", "epe": "EPE", "jaw_r": "jaw r", "jerk_per_speed": "jerk / speed"}


def ablation_changes() -> str:
    """Change of the mean without a part, beside the paper's."""
    found = report("ablations")
    rows = []
    for variant, (part, paper) in PARTS.items():
        for metric, title in CHANGES.items():
            pairs = [
                [found[v]["network"][source][metric]["mean"] for v in (variant, "full")]
                for source in SOURCES
            ]
            change = [
                f"{a - b:+z.2f}" if metric == "jaw_r" else f"{100 * (a / b - 1):+z.0f} %"
                for a, b in pairs
            ]
            rows.append([f"{part}: {title}", paper.get(metric, "–"), *change])
    return table([["without", "the paper", *SOURCES.values()], *rows])
