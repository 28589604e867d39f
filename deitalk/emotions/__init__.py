"""Emotions and their intensity over time: labels, weights, keyframes, edited curves."""

from deitalk.emotions.actor import ActorReference, parse_actor, read_actor
from deitalk.emotions.tracks import (
    EmotionTrack,
    IntensityCurve,
    by_emotion,
    parse_emotion,
    parse_intensity_curve,
    read_emotion_track,
    read_intensity_curve,
    write_intensity_csv,
)
from rig.emotions import EMOTIONS, LABELS, MOODS

__all__ = [
    "EMOTIONS",
    "LABELS",
    "MOODS",
    "ActorReference",
    "EmotionTrack",
    "IntensityCurve",
    "by_emotion",
    "parse_actor",
    "parse_emotion",
    "parse_intensity_curve",
    "read_actor",
    "read_emotion_track",
    "read_intensity_curve",
    "write_intensity_csv",
]
