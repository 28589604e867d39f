"""`python -m deitalk.research ablate`: train variants of a configuration and compare them."""

from pathlib import Path
from typing import Annotated

import typer

from deitalk.cli.console import bar, console, emit
from deitalk.cli.options import MAX_COUNT
from deitalk.research.cli.options import Most, Split


def ablate(
    data: Annotated[Path, typer.Option(help="Dataset folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the runs and the table.")],
    configs: Annotated[
        Path, typer.Option(help="Folder of variants: base and overrides in each file.")
    ] = Path("configs/ablations"),
    only: Annotated[
        list[str] | None, typer.Option("--only", help="This variant; may be given again.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="For all variants: data.noise_folder=noise.")
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(min=1, max=MAX_COUNT, help="Steps of every run; default: as configured."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Runs of every variant.")] = 3,
    split: Split = "test",
    most: Most = None,
    probes: Annotated[
        int,
        typer.Option(min=0, max=MAX_COUNT, help="Recordings per source for style separation."),
    ] = 4,
) -> None:
    """Train every variant with several seeds, score them, write OUT/ablations.md and .json.

    A stopped ablation is continued by the same command.

    Examples
    --------
    python -m deitalk.research ablate --data corpus/ -o runs/ablations

    ablate --data corpus/ -o runs/quick --only full --only no_dei --steps 600 --seeds 1

    ablate --configs configs/comparison --data corpus/ -o runs/comparison --steps 300

    ablate --configs configs/mesh_ablations --data corpus/ -o runs/mesh_ablations
    """
    with console().status("loading"):
        from deitalk.errors import ConfigError
        from deitalk.research.training.ablation import ablate as run
        from deitalk.research.training.ablation import as_markdown, read_variants

        variants = read_variants(configs)
    unknown = set(only or ()) - {variant.name for variant in variants}
    if unknown:
        names = ", ".join(variant.name for variant in variants)
        raise ConfigError(f"--only {sorted(unknown)[0]}: no such variant; there are {names}")
    chosen = [variant for variant in variants if not only or variant.name in only]
    with bar("ablations") as progress:
        order = [f"{variant.name} seed{seed}" for seed in range(seeds) for variant in chosen]
        table = run(
            chosen,
            data,
            out,
            steps=steps,
            seeds=seeds,
            split=split,
            most=most,
            probes=probes,
            overrides=overrides or (),
            progress=lambda name, share: progress((order.index(name) + share) / len(order)),
        )
    emit(as_markdown(table, split, seeds))
