"""The emotions, in the order of every track and table: the one list of their names."""

COLORS = {
    "neutral": "#969eaa",
    "angry": "#e2564a",
    "happy": "#f5be42",
    "sad": "#548edc",
    "surprised": "#b074dc",
}
"""Colour of each in the page and in videos. Other tables may have more of an emotion; one that they
lack is there as calm as `neutral`."""
EMOTIONS = tuple(COLORS)
"""DEITalk §3.1: the labels of ETH-3D."""
