"""Tables of mesh models."""

from result_tables.common import Group, report, short, table
from result_tables.comparisons import spread


def sdfa() -> str:
    """The embedded SDFA on sentences with an /s/ before /p b m/, with and without its seal."""
    found = report("sdfa-test")["groups"]["all"]
    rows = [
        [f"{text} ({found[f'{kind}s']:.0f})", *(_closed(found, who + kind) for who in CLOSURES)]
        for kind, text in SOUNDS.items()
    ]
    title = f"{found['clips']:.0f} test recordings: closed to 1 mm, median gap"
    people = report("sdfa-lips")["groups"]["all"]
    errors = (
        f"Mean error of the lips on {people['clips']:.0f} sentences of people whose lips were "
        f"measured: {short(people['lips_mm'], 2)} mm (at rest {short(people['still_mm'], 2)} mm).\n"
    )
    return table([[title, *CLOSURES.values()], *rows]) + "\n" + errors


SOUNDS = {"bilabial": "p b m", "after_s": "p b m after s", "vowel": "vowels"}

CLOSURES = {"": "as given", "unsealed_": "before the seal", "truth_": "truth"}


def _closed(found: Group, name: str) -> str:
    return f"{100 * found[f'{name}_closed']:.1f} %, {short(found[f'{name}_gap_mm'], 2)} mm"


MESH_VARIANTS = {
    "full": "SDFA small",
    "no_spec_bilstm": "convolutions in place of the Spec-BiLSTM",
    "no_attention": "convolutions in place of the attention",
    "karras": "Karras-style, offsets",
    "voca": "VOCA-style, offsets",
}

MESH_METRICS = {
    "lips_mm": ("lips, mean error, mm", 1, 2),
    "unsealed_bilabial_gap_mm": ("p b m, median gap before the seal, mm", 1, 2),
    "unsealed_bilabial_closed": ("closed to 1 mm before the seal, %", 100, 0),
    "bilabial_closed": ("closed, sealed where the model has a seal, %", 100, 0),
    "vowel_closed": ("vowels closed, %", 100, 1),
}


def mesh_ablations() -> str:
    """SDFA without its parts, and two older networks (§5.2.2, Table 4's rows)."""
    found = report("mesh-ablations")
    rows = [
        [shown, *(spread(found[name]["groups"]["all"], m, MESH_METRICS) for m in MESH_METRICS)]
        for name, shown in MESH_VARIANTS.items()
        if name in found
    ]
    still = found["full"]["groups"]["all"]["still_mm"]["mean"]
    title = f"test recordings; lips at rest: {short(still, 2)} mm"
    return table([[title, *(head for head, _, _ in MESH_METRICS.values())], *rows])


WHO = {"model": "mesh head", "curves": "the rig with the curves"}


def mesh_head() -> str:
    """The embedded mesh head beside the rig posed by the same network's curves."""
    whole = report("mesh-head-test")
    found = whole["groups"]["all"]
    closed = (
        f"{_share(found, 'bilabial')} ({_share(found, 'unsealed_bilabial')} before the seal)",
        _share(found, "curves_bilabial"),
        _share(found, "truth_bilabial"),
    )
    rows = [
        [
            f"lips, mean error, mm ({short(found['still_mm'], 2)} at rest)",
            *(short(found[f"{who}lips_mm"], 2) for who in ("", "curves_")),
            "",
        ],
        [
            "all vertices, mean error, mm",
            *(short(found[f"{who}mesh_mm"], 2) for who in ("", "curves_")),
            "",
        ],
        [f"p b m ({found['bilabials']:.0f}) closed to 1 mm", *closed],
        [
            f"vowels ({found['vowels']:.0f}) that close",
            *(_share(found, f"{who}vowel") for who in ("", "curves_", "truth_")),
        ],
    ]
    title = f"{found['clips']:.0f} test recordings"
    return table([[title, *WHO.values(), "truth"], *rows])


def _share(found: Group, name: str) -> str:
    return f"{100 * found[f'{name}_closed']:.1f} %"


ATTENTION = {
    "mel-attention": "`mel`",
    "sdfa-attention": "`sdfa`",
    "attention-centre": "trained alike with the path",
    "attention-0": "without it",
    "attention-1": "the same, another seed",
    "attention-window": "and with `recurrence: window`",
}


def attention() -> str:
    """How even the attention is: embedded models, then without the path around the attention."""
    rows = []
    for name, title in ATTENTION.items():
        kinds = [report(name)[kind] for kind in ("vowels", "plosives")]
        evenness = [short(kind["evenness"], 4) for kind in kinds]
        peaks = ", ".join(short(kind["peak"]) for kind in kinds)
        rows.append([title, *evenness, peaks])
    counts = ", ".join(f"{report(name)[kind]['phones']} {kind}" for kind in ("vowels", "plosives"))
    heads = [f"evenness at {counts}", "vowels", "plosives", "largest weight at either"]
    return table([heads, *rows])


def retargeting() -> str:
    """Errors of a retarget from the embedded head to others."""
    rows = [
        [
            f"{row['way']}, head {row['head']}",
            *(short(row[f"{part}_mm"], 2) for part in ("moving", "lips", "open_jaw_lips")),
        ]
        for row in report("retargeting")["retargeting"]
    ]
    heads = ["mean error, mm", "moving vertices", "lips", "lips of the wide open jaw"]
    return table([heads, *rows])
