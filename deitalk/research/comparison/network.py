"""What the networks of DEITalk's comparison have in common."""

from deitalk.errors import CheckpointError
from deitalk.models.curve_model import DEITalk
from deitalk.models.rig_decoder import RigDecoder
from deitalk.research.config import ComparedModelConfig


class ComparedNetwork(DEITalk):
    """DEITalk's network with the decoder of another paper; parameters as for `DEITalk`."""

    config: ComparedModelConfig

    @property
    def rig_decoder(self) -> RigDecoder:
        """None: it is fine-tuned and exported alone.

        Raises
        ------
        CheckpointError
            Always.
        """
        raise CheckpointError(f"a model with decoder: {self.config.decoder} is for comparison")
