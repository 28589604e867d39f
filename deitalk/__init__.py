"""Speech in, an acted MetaHuman face out.

>>> from deitalk import animate
>>> performance = animate("speech.wav", "happy")
>>> performance.curves["CTRL_C_jaw.ty"]
>>> performance.save("take/")
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "EMOTIONS",
    "DeitalkError",
    "EmotionTrack",
    "IntensityCurve",
    "MeshPerformance",
    "Performance",
    "Recording",
    "__version__",
    "animate",
    "animate_mesh",
    "load_audio",
    "load_model",
    "recording_from_array",
]

if TYPE_CHECKING:
    from deitalk.audio import Recording, load_audio
    from deitalk.checkpoint import load_model
    from deitalk.emotions import EMOTIONS, EmotionTrack, IntensityCurve
    from deitalk.errors import DeitalkError
    from deitalk.mesh_pipeline import MeshPerformance, animate_mesh
    from deitalk.performance import Performance
    from deitalk.pipeline import animate
    from deitalk.recording_arrays import recording_from_array

_HOMES = {
    "audio": ("Recording", "load_audio"),
    "checkpoint": ("load_model",),
    "emotions": ("EMOTIONS", "EmotionTrack", "IntensityCurve"),
    "errors": ("DeitalkError",),
    "mesh_pipeline": ("MeshPerformance", "animate_mesh"),
    "performance": ("Performance",),
    "pipeline": ("animate",),
    "recording_arrays": ("recording_from_array",),
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that ``import deitalk`` costs nothing."""
    for home, names in _HOMES.items():
        if name in names:
            from importlib import import_module

            return getattr(import_module(f"deitalk.{home}"), name)
    raise AttributeError(f"module 'deitalk' has no attribute {name!r}")
