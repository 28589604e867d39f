"""The phone set, its classes, and the windows for scores of the lips.

ARPABET with the reduced vowels and the flap that speech engines distinguish (AX, IX, DX), the
glottal stop (Q) and silence (SIL): 44 names.
"""

from collections.abc import Sequence

PHONES = tuple(
    "SIL Q IY IH IX EY EH AE AA AO AH AX ER UH UW OW AY AW OY P B M F V TH DH T D N L DX S Z SH ZH "
    "CH JH K G NG HH R W Y".split()
)
SILENCE = "SIL"
VOWELS = frozenset("IY IH IX EY EH AE AA AO AH AX ER UH UW OW AY AW OY".split())
BILABIALS = frozenset("PBM")
LABIODENTALS = frozenset("FV")
NEAR_LIPS = BILABIALS | LABIODENTALS | {"W"}
"""Phones that exclude neighbouring vowels from the scores of the lips."""
PLOSIVES = frozenset("PBTDKG")
STOPS = PLOSIVES | {"CH", "JH", "DX"}
"""Phones that begin with a closure, during which there is little or no sound."""
WIDEN_FRAMES = 2
"""Frames at 30 Hz by which the window of a contact is widened on both sides."""
CLEAR_SECONDS = 0.067
"""Least distance of a clear vowel from a contact, seconds."""

Phones = Sequence[tuple[float, float, str]]
"""Start and end in seconds, and the name."""
