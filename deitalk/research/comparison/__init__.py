"""Networks that DEITalk and SDFA are compared with.

DEITalk, Table 1: the decoders of FaceFormer (Fan et al., CVPR 2022) and EmoTalk (Peng et al.,
ICCV 2023), which get DEITalk's speech features and emotions and are written anew after the papers,
as far as these and the authors' published code describe them. SDFA, Table 4: the encoders of
`karras` and `voca`.
"""

from deitalk.research.comparison.emotalk import EmoTalk, EmoTalkDecoder
from deitalk.research.comparison.faceformer import FaceFormerDecoder

DECODERS = {"faceformer": FaceFormerDecoder, "emotalk": EmoTalkDecoder}
"""By ``model.decoder`` of a configuration."""

__all__ = ["DECODERS", "EmoTalk"]
