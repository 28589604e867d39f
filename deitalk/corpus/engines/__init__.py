"""Speech synthesisers that tell when each phone is said: espeak-ng, flite and festival."""

from deitalk.corpus.engines import espeak, festival, flite

ENGINES = ("espeak", "flite", "festival")


def available_engines() -> dict[str, str | None]:
    """Which engines work on this machine.

    Returns
    -------
    reasons : dict
        Engine name -> None if it works, else why not and what to install.
    """
    return {
        "espeak": espeak.missing(),
        "flite": flite.missing(),
        "festival": festival.missing(),
    }
