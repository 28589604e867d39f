"""Networks that DEITalk and SDFA are compared with.

DEITalk, Table 1: the decoders of FaceFormer (Fan et al., CVPR 2022) and EmoTalk (Peng et al.,
ICCV 2023), which get DEITalk's speech features and emotions and are written anew after the papers,
as far as these and the authors' published code describe them. SDFA, Table 4: the encoders of
`karras` and `voca`.
"""

import torch

from deitalk.models.rig_decoder import Decoder
from deitalk.research.comparison.emotalk import EmoTalk
from deitalk.research.comparison.faceformer import FaceFormerDecoder
from deitalk.research.comparison.network import ComparedNetwork

__all__ = ["EmoTalk", "FaceFormer"]


class FaceFormer(ComparedNetwork):
    """The network with FaceFormer's decoder; parameters as for `DEITalk`."""

    def new_decoder(self) -> Decoder:
        """Make FaceFormer's decoder."""
        rest = torch.tensor(self.controls.rest)
        return FaceFormerDecoder(self.config, self.frontend.output_size, rest)
