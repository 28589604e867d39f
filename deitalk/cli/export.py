"""`deitalk export`: what other programs and browsers run by themselves."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import console
from deitalk.cli.options import CheckedCommands, Force, Identity
from deitalk.cli.targets import reserve_folder

app = CheckedCommands(help="Export what browsers run by themselves.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Export what browsers run by themselves."""


@app.command()
def web(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write.")],
    model: Annotated[str, typer.Option(help="default, or the folder of such a model.")] = "default",
    identity: Identity = "0",
    live: Annotated[bool, typer.Option(help="Animate the microphone too (5 MB).")] = True,
    force: Force = False,
) -> None:
    """Write a static folder that animates recordings in a browser, without a service.

    Any static host serves it, or `python -m http.server -d site`. Drop a recording or speak, choose
    an emotion, edit the intensity, save the curves: nothing leaves the machine.

    Examples
    --------
    deitalk export web -o site/
    """
    from deitalk.preview.site import export_site
    from rig.face.identity import identity_of

    head = identity_of(identity)
    reserve_folder(out, kind="site", force=force)
    with console().status("exporting the model"):
        size = export_site(out, model, head, live=live, force=force)
    console().print(f"{out}: {size / 1e6:.1f} MB; python -m http.server -d {out}")
