"""SDFA's Table 4 on this machine, three mesh models by stage: ``evaluate --speed --mesh``.

The models have the papers' sizes and random weights, which determine the time. The mesh is
the embedded head's skin (8,434 triangles; VOCASET's has 9,976), the clip 5.1 s of noise with the
rhythm of speech, animated at 60 fps, in one process with a given number of threads.

Letters: T frames, W spectra of a window.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.load import parse_config
from deitalk.config.mesh import SDFAConfig, SDFAModelConfig
from deitalk.frontends.base import window_index
from deitalk.frontends.sdfa_encoder import SDFAEncoder
from deitalk.models.checkpoint import require_model, save_model
from deitalk.models.deformation_decoder import InversePCA
from deitalk.models.mesh_model import SDFA
from deitalk.pipeline.speech import Speech
from deitalk.research.config import ComparedSDFAModelConfig, KarrasConfig, VocaConfig
from deitalk.research.evaluation.benchmark_curves import TABLE_4_SECONDS, speechlike
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.meshes.sources import head_templates
from deitalk.research.meshes.training import new_mesh_model
from rig.face.head import UNIT_MM
from rig.mesh.deformation import mesh_solver

FPS = 60
SPEAKERS = 8
COMPONENTS = {"stretch": 85, "rotation": 180}
"""Components of SDFA's bases (Table 3)."""
KARRAS_COMPONENTS, VOCA_COMPONENTS = 150, 50
"""Components of the offset bases of the other two models; recalled, not verified."""
STAGES = (
    "set static mesh", "preprocess audio", "audio feature", "animation feature", "reconstruct mesh",
    "total with loading",
)  # fmt: skip
PUBLISHED = {
    "Karras-style": (None, 1672.15, 376.09, 51.06, None, 2531.80),
    "VOCA-style": (None, 8.94, 9253.29, 578.35, None, 11999.58),
    "SDFA": (13.15, 553.92, 4200.69, 545.03, 589.57, 6425.50),
}
"""SDFA Table 4, milliseconds, on an i7-8700K (number of threads not given)."""


class RecogniserSized(nn.Module):
    """A random network of the size of DeepSpeech 0.1, the audio feature of VOCA.

    Sizes (not verified): 19 frames of 26 cepstra at 50 per second, dense layers of 2048, a
    bidirectional LSTM of 2048, 29 letters. Its 123 million weights are 468 MiB; SDFA §4.4 gives
    VOCA with it as 477.3 MB.
    """

    RATE = 50

    def __init__(self) -> None:
        super().__init__()
        self.before = nn.Sequential(
            nn.Linear(19 * 26, 2048), nn.ReLU(), nn.Linear(2048, 2048), nn.ReLU(),
            nn.Linear(2048, 4096), nn.ReLU(),
        )  # fmt: skip
        self.recurrent = nn.LSTM(4096, 2048, batch_first=True, bidirectional=True)
        self.after = nn.Sequential(nn.Linear(4096, 2048), nn.ReLU(), nn.Linear(2048, 29))

    def forward(self, cepstra: Tensor) -> Tensor:
        """Map (1, L, 494) to (1, L, 29)."""
        out: Tensor = self.after(self.recurrent(self.before(cepstra))[0])
        return out


def table_4(threads: int = 1, repeats: int = 3, seconds: float = TABLE_4_SECONDS) -> dict[str, Any]:
    """Time every stage of the three models on one clip.

    Parameters
    ----------
    threads : int
        CPU threads of torch; the reconstruction always uses one.
    repeats : int
        Runs; the best of each stage is reported.
    seconds : float
        Length of the clip.

    Returns
    -------
    dict
        ``milliseconds``: model, stage (`STAGES`; None where there is none); ``megabytes``: model,
        trained and fixed parts, float32; ``per_window``: see `per_window`; ``frames``;
        ``published``: `PUBLISHED`.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        models = _models()
        sound = speechlike(seconds)
        out: dict[str, Any] = {"threads": threads, "milliseconds": {}, "megabytes": {}}
        for name, model in models.items():
            out["milliseconds"][name] = _best(partial(_stages, model, sound), repeats)
            fixed = sum(
                buffer.numel() * buffer.element_size()
                for branch in model.decoder.branches.values()
                for buffer in branch.inverse_pca.buffers()
            )
            out["megabytes"][name] = {"trained": _parameters(model) / 2**20, "fixed": fixed / 2**20}
        recogniser = RecogniserSized()
        out["megabytes"]["VOCA-style"]["recogniser"] = _parameters(recogniser) / 2**20
        cepstra = torch.zeros(1, round(seconds * recogniser.RATE), 494)
        with torch.no_grad():
            spent = _best(lambda: _timed({"r": lambda: recogniser(cepstra)}), repeats)["r"]
        assert spent is not None
        out["recogniser_ms"] = spent
        out["per_window"] = per_window(models["SDFA"], sound, repeats)
        out["frames"] = -(-len(sound) * FPS // SAMPLE_RATE)
        out["published"] = {name: list(row) for name, row in PUBLISHED.items()}
        return out
    finally:
        torch.set_num_threads(before)


def per_window(model: SDFA, sound: Any, repeats: int) -> dict[str, float]:
    """The audio-feature stage against one evaluation for every window (SDFA §5.3's batch).

    Returns
    -------
    dict
        `shared_ms`, as in `deitalk.models.mesh_model`; `windows_ms`, every frame's window
        separately through convolutions, both BiLSTMs and attention; `ratio`; `largest_difference`
        of the features, and their largest value `largest`.
    """
    (chunk,) = model.feature_chunks(torch.from_numpy(Speech.of(sound).sound))
    encoder = model.encoder
    assert isinstance(encoder, SDFAEncoder)

    def windows() -> Tensor:
        index = window_index(chunk.places, encoder.config.window_frames, chunk.features.shape[-1])
        rows = []
        for part in torch.split(index, 64):  # the fastest chunk in a measurement
            window = chunk.features[0][:, :, part].permute(2, 0, 1, 3)  # (T, 3, F, W)
            rows.append(encoder.attend(encoder.frontend.spectral(window))[0])
        return torch.cat(rows)

    with torch.no_grad():
        shared = encoder(chunk.features, chunk.places)[0]
        alone = windows()
        laps = _best(
            lambda: _timed(
                {"shared": lambda: encoder(chunk.features, chunk.places), "windows": windows}
            ),
            repeats,
        )
    fast, slow = laps["shared"], laps["windows"]
    assert fast is not None and slow is not None
    return {
        "shared_ms": fast,
        "windows_ms": slow,
        "ratio": slow / fast,
        "largest_difference": float((shared - alone).abs().max()),
        "largest": float(shared.abs().max()),
    }


def _models() -> dict[str, SDFA]:
    """The three models with the papers' sizes and random weights."""
    ways = {
        "Karras-style": ComparedSDFAModelConfig(
            frontend=KarrasConfig(), motion="offsets", shared_size=None, branch_sizes=()
        ),
        "VOCA-style": ComparedSDFAModelConfig(
            frontend=VocaConfig(), motion="offsets", shared_size=None, branch_sizes=(128,)
        ),
        "SDFA": SDFAModelConfig(),
    }
    ((name, template),) = head_templates((0,)).items()
    speakers = [f"{name}{i}" for i in range(SPEAKERS)]
    n, v = len(template.faces), len(template.vertices)
    sizes = {
        "Karras-style": {"offsets": (KARRAS_COMPONENTS, 3 * v)},
        "VOCA-style": {"offsets": (VOCA_COMPONENTS, 3 * v)},
        "SDFA": {k: (c, (6 if k == "stretch" else 3) * n) for k, c in COMPONENTS.items()},
    }
    models = {}
    for key, config in ways.items():
        torch.manual_seed(0)
        layers = {branch: InversePCA(*size) for branch, size in sizes[key].items()}
        for layer in layers.values():
            layer.components.normal_(std=1e-3)
        model = new_mesh_model(
            config, layers, dict.fromkeys(speakers, template), fps=FPS, unit_mm=UNIT_MM
        )
        assert isinstance(model, SDFA)
        models[key] = model.eval()
    return models


@torch.no_grad()
def _stages(model: SDFA, sound: Any) -> dict[str, float | None]:
    """Milliseconds of every stage of one run."""
    state: dict[str, Any] = {}
    label = model.label(0)
    is_solved = model.config.motion == "gradients"

    def motion() -> None:
        rows = state["feature"]
        state["motion"] = model.decoder.expand(model.decoder(rows, label.expand(len(rows), -1)))

    def reconstruct() -> None:
        s, r = (rows.double().numpy() for rows in state["motion"])
        state["solver"].solve(s, r)

    def moved() -> None:
        motion()
        model.vertices(state["motion"], model.template(0))

    laps: dict[str, Callable[[], Any]] = {
        "set static mesh": lambda: state.update(solver=mesh_solver(model.template(0))),
        "preprocess audio": lambda: state.update(
            chunks=list(model.feature_chunks(torch.from_numpy(Speech.of(sound).sound)))
        ),
        "audio feature": lambda: state.update(
            feature=torch.cat(
                [model.encoder(c.features, c.places)[0, c.kept] for c in state["chunks"]]
            )
        ),
        "animation feature": motion,
        "reconstruct mesh": reconstruct,
    }
    if not is_solved:
        laps = {name: laps[name] for name in STAGES[1:4]}
        laps["animation feature"] = moved
    out: dict[str, float | None] = dict.fromkeys(STAGES)
    out |= _timed(laps)
    with _saved(model) as folder:
        out |= _timed({STAGES[-1]: lambda: predict_mesh(require_model(folder, SDFA), sound)})
    return out


@contextmanager
def _saved(model: SDFA) -> Iterator[Path]:
    config = parse_config({"kind": "sdfa_compared", "model": model.config.model_dump(mode="json")})
    assert isinstance(config, SDFAConfig)
    with tempfile.TemporaryDirectory() as folder:
        save_model(Path(folder) / "model", model, config, {}, half_bases=False)
        yield Path(folder) / "model"


def _timed(laps: dict[str, Callable[[], Any]]) -> dict[str, float | None]:
    """CPU milliseconds of each stage, in order.

    CPU time is robust against other load; with several threads wall time is used instead.
    """
    out: dict[str, float | None] = {}
    for name, lap in laps.items():
        wall, cpu = time.perf_counter(), time.process_time()
        lap()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        out[name] = 1000 * (min(cpu, wall) if torch.get_num_threads() == 1 else wall)
    return out


def _best(run: Callable[[], dict[str, float | None]], repeats: int) -> dict[str, float | None]:
    runs = [run() for _ in range(repeats)]
    return {
        name: None if value is None else min(r[name] or 0.0 for r in runs)
        for name, value in runs[0].items()
    }


def _parameters(module: nn.Module) -> int:
    return sum(p.numel() * p.element_size() for p in module.parameters())


def as_markdown(report: dict[str, Any]) -> str:
    """Table 4, measured and published, and the other measurements, in Markdown."""
    names = list(report["milliseconds"])
    lines = [
        f"Milliseconds for {report['frames']} frames, {report['threads']} thread(s); published: "
        "SDFA Table 4, i7-8700K.",
        "",
        "| Stage | " + " | ".join(f"{n} | published" for n in names) + " |",
        "|---" * (2 * len(names) + 1) + "|",
    ]
    for row, stage in enumerate(STAGES):
        cells = []
        for name in names:
            cells += [_cell(report["milliseconds"][name][stage]), _cell(PUBLISHED[name][row])]
        lines.append(f"| {stage} | " + " | ".join(cells) + " |")
    sizes = [
        ", ".join(f"{kind} {size:.1f}" for kind, size in report["megabytes"][name].items())
        for name in names
    ]
    lines.append("| MiB, float32 | " + " | ".join(f"{size} | " for size in sizes) + " |")
    windows = report["per_window"]
    lines += [
        "",
        f"VOCA's audio feature is DeepSpeech; a random network of its size takes "
        f"{report['recogniser_ms']:.0f} ms more.",
        "",
        f"SDFA's audio feature, every window on its own: {windows['windows_ms']:.0f} ms, "
        f"{windows['ratio']:.1f} times {windows['shared_ms']:.0f}; largest difference "
        f"{windows['largest_difference']:.1e} of {windows['largest']:.2f}.",
    ]
    return "\n".join(lines) + "\n"


def _cell(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}" if value >= 100 else f"{value:.1f}"
