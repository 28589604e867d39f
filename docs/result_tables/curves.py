"""Tables of curve models: scores, lips of people, noise, styles, live."""

from collections.abc import Callable

from result_tables.common import MEASURES, SOURCES, Group, report, short, table

COLUMNS = (
    ("LibriSpeech", "default-test", "librispeech"),
    ("speechocean762 adults", "default-test", "speechocean-adults"),
    ("its children", "default-test", "speechocean-children"),
    ("espeak-ng English", "default-test", "espeak"),
    ("two fresh readers", "default-fresh", "fresh"),
)
"""Heading, report and group of each column."""

Cell = Callable[[Group, Group], str]
"""Scores of a group, as animated and of the network alone, to the text of a cell."""


def _both(name: str, digits: int = 3) -> Cell:
    return lambda a, b: f"{short(a[name], digits)} ({short(b[name], digits)})"


def _percent(name: str) -> Cell:
    return lambda a, b: f"{short(100 * a[name], 1)} % ({short(100 * b[name], 1)})"


def _one(name: str) -> Cell:
    return lambda a, b: short(a[name])


SCORES: dict[str, Cell] = {
    "bilabials found": _both("bilabial_hits_at_5_percent"),
    "... where at most 15 % of the speech is labelled silence (recordings)": lambda a, b: (
        f"{short(a['bilabial_hits_in_labelled_clips'])} ({a['labelled_clips']})"
    ),
    "bilabial AUC, windows": _both("bilabial_window_auc"),
    "AUC of loudness alone, windows": _one("loudness_bilabial_window_auc"),
    "found closures held at .9 for two frames": _both("found_bilabials_held_at_0.9", 2),
    "frames with shut lips on sounds other than p b m f v": _percent("shut_on_other_sounds"),
    "jaw r against the tables (loudness alone)": lambda a, b: (
        f"{short(a['jaw_r'])} ({short(a['loudness_jaw_r'])})"
    ),
    "jaw lag": lambda a, b: f"{a['jaw_lag_ms']:.0f} ms",
    "mouth opening in silence (times of the phones) against speech": _percent("opening_in_silence"),
    "LPE over `lip`": _both("lpe"),
    "EPE over `upper_face`, of acted takes": _both("epe", 4),
}

CONTOURS: dict[str, str] = {
    "predicted": "intensity_rho",
    "the network alone": "network_rho",
    "prosody index alone": "index_rho",
    "level alone": "level_rho",
}


def scores() -> str:
    """Scores of the default model on its test speakers, the network alone in brackets."""
    heads, groups = [], []
    for title, name, group in COLUMNS:
        both = report(name)["groups"][group], report(name)["network"][group]
        heads.append(f"{title} ({both[0]['clips']})")
        groups.append(both)
    rows = [[name, *(cell(*both) for both in groups)] for name, cell in SCORES.items()]
    return table([["test speakers (recordings)", *heads], *rows])


def intensity() -> str:
    """How the predicted intensity follows a voice, beside what is simpler."""
    heads = [title for title, _, _ in COLUMNS]
    contours = [report(name)["contours"][group] for _, name, group in COLUMNS]
    rows = [[t, *(short(c[key], 2) for c in contours)] for t, key in CONTOURS.items()]
    above = [f"{short(c['above_level'], 2)} ± {short(c['above_level_error'], 2)}" for c in contours]
    rows.append(["predicted less level, with its standard error", *above])
    return table([["", *heads], *rows])


def lips() -> str:
    """The default model beside lips measured on people, mean over speakers."""
    found = report("default-lips")
    rows = [
        ("network alone, r", "network", "r"),
        ("as `deitalk animate` returns them, r", "animated", "r"),
        ("loudness, r", "loudness", "r"),
        ("range over the measured one, network alone", "network", "range"),
        ("speed over the measured one, network alone", "network", "speed"),
    ]
    cells = [
        [text, *(short(found[name]["mean"][f"{measure} {score}"], 2) for measure in MEASURES)]
        for text, name, score in rows
    ]
    return table([["", *MEASURES.values()], *cells])


def noise() -> str:
    """Closures and jaw in two noises outside the training."""
    rows = [
        [
            level,
            short(score["bilabial_window_auc"]),
            short(score["bilabial_hits_at_5_percent"], 2),
            short(score["jaw_r"], 2),
        ]
        for level, score in report("default-noise")["noise"].items()
    ]
    return table([["speech to noise", "bilabial AUC", "bilabials found", "jaw r"], *rows])


WIDENED = ("angry", "happy", "sad", "surprised")


def styles() -> str:
    """How much styles differ, and how far lips move in each."""
    groups = list(SOURCES)
    apart, wide = report("default-test")["styles"], report("default-validation")["styles"]
    rows = [
        [
            "distance of the two nearest styles / spread within a style",
            *(short(min(x["separation"] for x in apart[g]["styles"].values()), 1) for g in groups),
        ]
    ]
    rows += [
        [
            f"{emotion}: range of the lips over the neutral one",
            *(
                f"{short(x['range_strong'], 2)} ({short(x['range'], 2)})"
                for x in (wide[g]["styles"][emotion] for g in groups)
            ),
        ]
        for emotion in WIDENED
    ]
    return table([["", *(SOURCES[name] for name in groups)], *rows])


LIVE: dict[str, tuple[str, int]] = {
    "bilabials found": ("bilabial_hits_at_5_percent", 3),
    "bilabial AUC, windows": ("bilabial_window_auc", 3),
    "found closures held at .9 for two frames": ("found_bilabials_held_at_0.9", 2),
    "shut on other sounds": ("shut_on_other_sounds", 3),
    "jaw r against the tables": ("jaw_r", 3),
}
"""Scores of `live` beside `default`, and their digits."""


def live() -> str:
    """The live model / the default model by the same command, and both beside measured lips."""
    groups = {
        name: (report("live-test")["groups"][name], report("default-test")["groups"][name])
        for name in SOURCES
    }
    rows = [
        [text, *(" / ".join(short(g[key], digits) for g in both) for both in groups.values())]
        for text, (key, digits) in LIVE.items()
    ]
    speech = table([["`live` / `default`", *(SOURCES[name] for name in groups)], *rows])
    found = report("live-lips"), report("default-lips")
    people = [
        " / ".join(short(r["animated"]["mean"][f"{m} r"], 2) for r in found) for m in MEASURES
    ]
    return speech + "\n" + table([["lips of people", *MEASURES.values()], ["r", *people]])


ACTED = {"high above low": 3, "rank correlation": 2}
"""Scores of acted strengths, and their digits."""
ACTED_GROUPS = ("anger and joy", "sadness", "fear", "disgust")
"""The last two are procedural moods of the face."""


def acted() -> str:
    """Order of acted strengths in the output of the default model."""
    columns = [(group, s) for group in ACTED_GROUPS for s in ACTED]
    rows = [
        [text, *(short(report("default-acted")[g][f"{name}: {s}"], ACTED[s]) for g, s in columns)]
        for name, text in (
            ("intensity", "predicted intensity over speech"),
            ("whole face", "distance of all curves from rest"),
            ("level", "mean level, the baseline"),
            ("joined, intensity", "intensity of the three takes in one recording"),
            ("joined, whole face", "distance from rest in it"),
            ("joined, brows", "brows in it"),
            ("joined, level", "mean level in it, the baseline"),
            ("joined at one level, intensity", "intensity, each take at one level"),
            ("joined at one level, whole face", "distance from rest, each at one level"),
            ("joined at one level, brows", "brows, each at one level"),
        )
    ]
    return table([["26 test actors", *(f"{g}: {s}" for g, s in columns)], *rows])


def acted_motion() -> str:
    """How far the intensity moves between and inside acted takes."""
    names = {
        "joined, intensity: step": "high less low, takes in one recording",
        "joined at one level, intensity: step": "the same, each take at one level",
        "intensity: range inside takes": "5th to 95th percentile inside middle and high takes",
        "intensity: r with level inside takes": "r with the level of the syllables there",
    }
    rows = [
        [text, *(short(report("default-acted")[group][name], 2) for group in ACTED_GROUPS)]
        for name, text in names.items()
    ]
    return table([["predicted intensity, 26 test actors", *ACTED_GROUPS], *rows])
