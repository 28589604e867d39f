"""What made the shipped weights and the tables of the documents: in a checkout, not in the wheel.

::

    corpus/       synthetic and recorded speech with phone times and curves
    training/     ablations, trainers of small networks, tools that change a model's weights
    meshes/       training and scores of mesh models
    comparison/   decoders and encoders of other papers
    evaluation/   scores of a model on a dataset folder; measurements that one table needs
    lips/         datasets of measured lips for experiments
    video/        filmed faces to curves; contact_sheet.py draws the head
    study/        blind comparisons by people
    cli/          the verbs ablate, attention, corpus, evaluate, folds, lips, sheet, study and train

`python -m deitalk.research` is the command line with its verbs. Nothing outside imports it; its
kinds of configurations and its reader of videos are added when it is imported.
"""

from deitalk.config.load import CONFIGS
from deitalk.data.captures.take import READERS
from deitalk.research.config import (
    ComparedConfig,
    ComparedSDFAConfig,
    MeshTrainingConfig,
    TrainingConfig,
)

CONFIGS |= {
    "training": TrainingConfig,
    "compared": ComparedConfig,
    "sdfa_training": MeshTrainingConfig,
    "sdfa_compared": ComparedSDFAConfig,
}
READERS["video"] = "deitalk.research.video.filmed:read_capture"
