"""Settings of models, losses, data and training; defaults are the papers' numbers.

A YAML file in ``configs/`` holds only what differs. Modules take plain numbers; only the builders
of networks and trainings read these classes, and the rules after the network theirs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deitalk.config.curves import (
        Config,
        DataConfig,
        FinetuneConfig,
        LossConfig,
        ModelConfig,
        TrainConfig,
        TuneConfig,
    )
    from deitalk.config.frontends import (
        CausalWhisperConfig,
        DEITalkFeaturesConfig,
        KarrasConfig,
        MelConfig,
        SDFAMelConfig,
        VocaConfig,
        Wav2VecConfig,
        WhisperConfig,
        WhisperShape,
    )
    from deitalk.config.load import AnyConfig, load_config, parse_config
    from deitalk.config.mesh import MeshDataConfig, MeshTrainConfig, SDFAConfig, SDFAModelConfig
    from deitalk.config.rules import Gates, Idle, KeepContacts, RulesConfig, VoiceIntensity

__all__ = [
    "AnyConfig",
    "CausalWhisperConfig",
    "Config",
    "DEITalkFeaturesConfig",
    "DataConfig",
    "FinetuneConfig",
    "Gates",
    "Idle",
    "KarrasConfig",
    "KeepContacts",
    "LossConfig",
    "MelConfig",
    "MeshDataConfig",
    "MeshTrainConfig",
    "ModelConfig",
    "RulesConfig",
    "SDFAConfig",
    "SDFAMelConfig",
    "SDFAModelConfig",
    "TrainConfig",
    "TuneConfig",
    "VocaConfig",
    "VoiceIntensity",
    "Wav2VecConfig",
    "WhisperConfig",
    "WhisperShape",
    "load_config",
    "parse_config",
]

_HOMES = {
    "curves": (
        "Config",
        "DataConfig",
        "FinetuneConfig",
        "LossConfig",
        "ModelConfig",
        "TrainConfig",
        "TuneConfig",
    ),
    "frontends": (
        "CausalWhisperConfig",
        "DEITalkFeaturesConfig",
        "KarrasConfig",
        "MelConfig",
        "SDFAMelConfig",
        "VocaConfig",
        "Wav2VecConfig",
        "WhisperConfig",
        "WhisperShape",
    ),
    "load": ("AnyConfig", "load_config", "parse_config"),
    "mesh": ("MeshDataConfig", "MeshTrainConfig", "SDFAConfig", "SDFAModelConfig"),
    "rules": ("Gates", "Idle", "KeepContacts", "RulesConfig", "VoiceIntensity"),
}


def __getattr__(name: str) -> Any:
    """Import a class at its first use: rules without the settings of networks and trainings."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"deitalk.config.{home}"), name)
    raise AttributeError(f"module 'deitalk.config' has no attribute {name!r}")
