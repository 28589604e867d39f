"""Tables of what people's voices, heads and answers are compared with."""

from result_tables.common import report, short, table
from result_tables.curves import ACTED

WORD_GROUPS = {
    "librispeech": "LibriSpeech",
    "speechocean children": "speechocean762, children",
    "speechocean adults": "its adults",
    "espeak-ng de": "espeak-ng German",
    "espeak-ng cmn": "Mandarin",
}


def known_words() -> str:
    """Bilabials found without words, with them and with wrong ones."""
    groups = report("known-words")["groups"]
    heads = [f"{title} ({groups[g]['bilabials']})" for g, title in WORD_GROUPS.items()]
    names = [name for name in groups["librispeech"] if name != "bilabials"]
    rows = [[name, *(short(groups[g][name]) for g in WORD_GROUPS)] for name in names]
    return table([["bilabials found (of)", *heads], *rows])


def head_motion() -> str:
    """Motion of the head of readers and of ours, neutral, on the same sounds."""
    found = report("head-motion")
    ratios = {"range": found["ratios"][:3], "speed": found["ratios"][3:]}
    rows = [
        [f"{what} of yaw, pitch, roll, {unit}", *_threes(found, what), _list(ratios[what])]
        for what, unit in (("range", "°"), ("speed", "°/s"))
    ]
    pairs = found["measured correlation"], found["correlation"]
    for place, text in ((0, "level"), (2, "stressed syllables")):
        cells = [f"{short(who[place], 2)} ({short(who[place + 1], 2)})" for who in pairs]
        rows.append([f"correlation of pitch with {text} (chance)", *cells, ""])
    nods = found["measured nods"], found["nods"]
    for text, places in (
        ("nods a second; their depth, °", (0, 1)),
        ("spread of depths, of intervals (standard deviation over mean)", (2, 3)),
    ):
        rows.append([text, *(_list([who[i] for i in places]) for who in nods), ""])
    return table([["head", "readers", "here", "ratio"], *rows])


def _threes(found: dict[str, list[float]], what: str) -> list[str]:
    return [_list(found[f"{who}{what}"]) for who in ("measured ", "")]


def _list(values: list[float]) -> str:
    return ", ".join(short(value, 2) for value in values)


def blinks() -> str:
    """Blinks of takes of readers."""
    found = report("blinks")["blinks"]
    return table([["blinks", "here"], *([name, value] for name, value in found.items())])


REGIONS = ("brows", "lids", "inner squint", "cheeks", "gaze", "head, °/s")


def motion_energy() -> str:
    """Mean change of the controls by region and emotion, and the spread of the most moving."""
    takes = report("motion-energy")["takes"]
    rows = [
        [region, *(f"{short(mean, 2)} ({short(spread)})" for mean, spread in cells)]
        for region in REGIONS
        for cells in [[take[region] for take in takes.values()]]
    ]
    return table([["region", *takes], *rows])


def suggestion() -> str:
    """Scores of suggested emotions."""
    found = report("suggestion")
    splits = ("cross-validation", "test")
    both = [found[f"map, {split}"] for split in splits]
    named = [name for name in both[0] if name.startswith("recall ")]
    rows = [
        [
            f"recall of {' / '.join(name.removeprefix('recall ') for name in named)}",
            *(" / ".join(short(s[name], 2) for name in named) for s in both),
        ]
    ]
    mean = "unweighted recall"
    rows.append(["their mean (chance .25)", *(short(s[mean], 2) for s in both)])
    for name, text in (("ridge", "ridge regression, same features"), ("level", "the level alone")):
        cells = (short(found[f"{name}, {split}"][mean], 2) for split in splits)
        rows.append([f"the same of {text}", *cells])
    for key, text in (
        ("anger against sadness", "anger against sadness"),
        ("calibration error", "expected calibration error, classes weighted alike"),
        ("readers neutral", "readers for whom neutral is suggested"),
    ):
        rows.append([text, *(short(s[key], 2) for s in both)])
    return table([["", *splits], *rows])


ORDERED = ("anger and joy", "sadness")


def vocal_strength() -> str:
    """Order of acted strengths by the voice's strength, level and pitch."""
    scores = report("vocal-strength")["scores"]
    names = [f"{group}: {score}" for group in ORDERED for score in ACTED]
    rows = [[name, *(short(found[name], 2) for found in scores.values())] for name in names]
    return table([["test speakers", *scores], *rows])


def phone_evidence() -> str:
    """Share of rows whose label comes first."""
    found = report("phone-evidence")["validation"]
    heads = ["rows (1/60 s) of validation speakers", "phone", "class of lips", "closed at p b m"]
    cells = [short(found[name], 2) for name in ("phone", "lips", "closed where p, b, m")]
    return table([heads, [f"{found['rows']}: the labelled one is the most probable", *cells]])
