"""Speech synthesisers with phone times: espeak-ng, flite and festival."""

from deitalk.research.corpus.engines import espeak, festival, flite

ENGINES = ("espeak", "flite", "festival")


def available_engines() -> dict[str, str | None]:
    """Availability of the engines on this machine.

    Returns
    -------
    reasons : dict
        Engine name -> None if it works, else the reason and the package to install.
    """
    return {
        "espeak": espeak.missing(),
        "flite": flite.missing(),
        "festival": festival.missing(),
    }
