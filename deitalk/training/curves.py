"""Network and data of every training of a DEITalk model (DEITalk §4.1).

The loop is `deitalk.training.trainer`.
"""

from collections.abc import Sequence
from pathlib import Path

from deitalk.config.curves import Config
from deitalk.config.rig_file import read_controls
from deitalk.data.clips import Clip
from deitalk.data.frozen_features import FrozenFeatures
from deitalk.data.windows import Window, count_windows
from deitalk.models.checkpoint import network_class
from deitalk.models.curve_model import DEITalk
from deitalk.models.weight_file import network_shapes
from deitalk.training.run_folder import record_data
from deitalk.training.trainer import Task


class CurveTask(Task[Window]):
    """DEITalk's network on windows of curves.

    Parameters
    ----------
    config : Config
        Model, loss, data and schedule.
    data : Path
        Dataset folder.
    frozen_features : FrozenFeatures or None
        Those of the frontend, where several runs share them.

    Raises
    ------
    ConfigError
        If the network is too large.
    """

    config: Config
    model: DEITalk
    clips: Sequence[Clip]
    """Clips to train on."""

    def __init__(
        self, config: Config, data: Path, *, frozen_features: FrozenFeatures | None = None
    ) -> None:
        self.config, self.data, self.frozen_features = config, data, frozen_features
        self.controls = read_controls(config.model.control_set)
        network_shapes(self._network)  # not too large to be built

    def _network(self, pretrained: bool = False) -> DEITalk:
        config = self.config
        network = network_class(config.model)
        return network(config.model, self.controls, pretrained=pretrained, rules=config.rules)

    def read(self, out: Path) -> None:
        """Check that a resumed run has its own data."""
        record_data(out, self.data)

    def epoch_size(self) -> int:
        """All windows of all clips."""
        return count_windows(self.clips, self.config.data)
