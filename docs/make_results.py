"""Write the tables of documents from the results of commands: ``make docs``.

``docs/results/*.json`` are reports of the commands in ``result_tables/commands.py``, of the weights
whose hash they hold; ``python docs/make_reports.py`` runs them. A table stands between
``<!-- table NAME -->`` and ``<!-- end -->``.
"""

import re
import sys
from collections.abc import Callable
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))

from result_tables import (  # noqa: E402
    comparisons,
    curves,
    finetuning,
    meshes,
    models,
    people,
    speed,
)

DOCUMENTS = tuple(
    path
    for path in (
        DOCS.parent / "README.md",
        DOCS.parent / "MODEL_CARD.md",
        *sorted(DOCS.glob("*.md")),
        DOCS / "results/README.md",
    )
    if "<!-- table " in path.read_text(encoding="utf-8")
)
_TABLE = re.compile(r"(<!-- table (\S+) -->\n).*?(?=<!-- end -->)", re.DOTALL)

TABLES: dict[str, Callable[[], str]] = {
    "scores": curves.scores,
    "intensity": curves.intensity,
    "lips": curves.lips,
    "noise": curves.noise,
    "styles": curves.styles,
    "live": curves.live,
    "acted": curves.acted,
    "acted-motion": curves.acted_motion,
    "ablation-changes": comparisons.ablation_changes,
    "comparison": comparisons.comparison,
    "sdfa": meshes.sdfa,
    "mesh-ablations": meshes.mesh_ablations,
    "mesh-head": meshes.mesh_head,
    "attention": meshes.attention,
    "retargeting": meshes.retargeting,
    "captured-lips": finetuning.captured_lips,
    "known-words": people.known_words,
    "head-motion": people.head_motion,
    "blinks": people.blinks,
    "motion-energy": people.motion_energy,
    "suggestion": people.suggestion,
    "vocal-strength": people.vocal_strength,
    "phone-evidence": people.phone_evidence,
    "live-speed": speed.live_speed,
    "batch-rate": speed.batch_rate,
    "cold-start": speed.cold_start,
    "onnx-sizes": speed.onnx_sizes,
    "device": speed.device,
    "service-load": speed.service_load,
    "table-4": speed.table_4,
    "models": models.models,
    "sizes": models.sizes,
}


def written(text: str) -> str:
    """A document with its tables as the results have them; a missing report is named instead."""
    return _TABLE.sub(lambda match: f"{match[1]}\n{_filled(match[2])}\n", text)


def _filled(name: str) -> str:
    try:
        return TABLES[name]()
    except FileNotFoundError as error:
        report = Path(error.filename).stem
        return f"No report `{report}`: `python docs/make_reports.py {report}`\n"


if __name__ == "__main__":
    for path in DOCUMENTS:
        path.write_text(written(path.read_text(encoding="utf-8")), encoding="utf-8")
