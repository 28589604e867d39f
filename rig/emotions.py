"""The emotions, in the order of every track and table: the one list of their names.

The network is trained on five. A mood is procedural: no capture taught it. It is shown as a mixture
of the five (`MOODS`) and a pose of its own (`deitalk/postprocess/expressions.csv`).
"""

COLORS = {
    "neutral": "#969eaa",
    "angry": "#e2564a",
    "happy": "#f5be42",
    "sad": "#548edc",
    "surprised": "#b074dc",
    "fear": "#58c4c0",
    "disgust": "#84b24a",
    "contempt": "#c28a5c",
    "calm": "#a8c8de",
}
"""Colour of each in the page and in videos. Other tables may have more of an emotion; one that they
lack is there as calm as `neutral`."""
MOODS = {
    "fear": {"surprised": 0.6, "sad": 0.25},
    "disgust": {"angry": 0.45, "sad": 0.15},
    "contempt": {"angry": 0.1, "happy": 0.1},
    "calm": {},
}
"""Weights of the trained emotions that the network reads for a mood at weight 1; the rest is
neutral."""
LABELS = tuple(COLORS)
EMOTIONS = LABELS[: -len(MOODS)]
"""DEITalk §3.1: the labels of ETH-3D."""
VARIANTS = {
    "angry": {"hot": 1, "cold": -1, "disgusted": 0},
    "happy": {"broad": 1, "warm": -1, "amused": 0},
    "sad": {"anguished": 1, "dejected": -1, "sorrowful": 0},
    "surprised": {"startled": 1, "puzzled": -1, "amazed": 0},
    "fear": {"terrified": 1, "wary": -1, "worried": 0},
    "disgust": {"revolted": 1, "averse": -1, "nauseated": 0},
    "contempt": {"scornful": 1, "haughty": -1, "smug": 0},
    "calm": {"attentive": 1, "relaxed": -1, "serene": 0},
}
"""Ways to show an emotion, each name once: points around its own pose; and where each is at home,
in a strong voice (1), a weak one (-1) or any (0)."""
PLAIN = "plain"
"""In place of a variant: the poses of the emotions themselves."""
