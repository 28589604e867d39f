"""Networks that DEITalk is compared with (Table 1): FaceFormer's and EmoTalk's decoders.

Both get the speech features and the emotions of DEITalk, and are written anew after the papers,
as far as these and the authors' published code describe them: FaceFormer (Fan et al., CVPR 2022)
and EmoTalk (Peng et al., ICCV 2023). `network_class` gives the class of a configuration.
"""

from deitalk.models.comparison.emotalk import network_class

__all__ = ["network_class"]
