"""MetaHuman facial animation from speech and an emotion.

>>> from deitalk import animate
>>> performance = animate("speech.wav", "happy")
>>> performance.curves["CTRL_C_jaw.ty"]
>>> performance.save("take/")
"""

from typing import TYPE_CHECKING, Any

from deitalk.installed import __version__

__all__ = [
    "EMOTIONS",
    "LABELS",
    "Acting",
    "BatchReport",
    "DeitalkError",
    "EmotionTrack",
    "IntensityCurve",
    "LiveAnimator",
    "MeshPerformance",
    "Performance",
    "Recording",
    "Suggestion",
    "Tuned",
    "__version__",
    "animate",
    "animate_batch",
    "animate_mesh",
    "finetune",
    "import_captures",
    "load_audio",
    "load_model",
    "push_to_hub",
    "recording_from_array",
    "suggest_emotion",
]

if TYPE_CHECKING:
    from deitalk.acting import Acting
    from deitalk.audio.arrays import recording_from_array
    from deitalk.audio.load import Recording, load_audio
    from deitalk.batch.report import BatchReport
    from deitalk.batch.run import animate_batch
    from deitalk.data.captures.imported import import_captures
    from deitalk.emotions import EMOTIONS, LABELS, EmotionTrack, IntensityCurve
    from deitalk.errors import DeitalkError
    from deitalk.live.animator import LiveAnimator
    from deitalk.models.checkpoint import load_model
    from deitalk.models.hub import push_to_hub
    from deitalk.pipeline.curves import animate
    from deitalk.pipeline.mesh import animate_mesh
    from deitalk.pipeline.mesh_performance import MeshPerformance
    from deitalk.pipeline.performance import Performance
    from deitalk.pipeline.suggest import Suggestion, suggest_emotion
    from deitalk.training.tuning.public import Tuned, finetune

_HOMES = {
    "acting": ("Acting",),
    "audio.load": ("Recording", "load_audio"),
    "batch.report": ("BatchReport",),
    "batch.run": ("animate_batch",),
    "models.checkpoint": ("load_model",),
    "models.hub": ("push_to_hub",),
    "emotions": ("EMOTIONS", "LABELS", "EmotionTrack", "IntensityCurve"),
    "data.captures.imported": ("import_captures",),
    "errors": ("DeitalkError",),
    "live.animator": ("LiveAnimator",),
    "pipeline.mesh": ("animate_mesh",),
    "pipeline.mesh_performance": ("MeshPerformance",),
    "pipeline.performance": ("Performance",),
    "pipeline.curves": ("animate",),
    "pipeline.suggest": ("Suggestion", "suggest_emotion"),
    "audio.arrays": ("recording_from_array",),
    "training.tuning.public": ("Tuned", "finetune"),
}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that ``import deitalk`` is fast."""
    for home, names in _HOMES.items():
        if name in names:
            from importlib import import_module

            return getattr(import_module(f"deitalk.{home}"), name)
    raise AttributeError(f"module 'deitalk' has no attribute {name!r}")
