"""Reports of measuring commands: JSON without NaN, the machine, the hash of the weights."""

import hashlib
import json
import os

import pytest

from deitalk.models.folder import embedded_models, model_folder
from deitalk.research.evaluation.benchmark_curves import machine
from deitalk.research.evaluation.report import identified, write_json


def test_json_has_null_for_what_is_not_finite(tmp_path):
    path = tmp_path / "report.json"
    write_json(path, {"a": float("nan"), "b": [1.5, float("inf"), {"c": (2, float("nan"))}]})
    assert json.loads(path.read_text()) == {"a": None, "b": [1.5, None, {"c": [2, None]}]}
    assert list(tmp_path.iterdir()) == [path]


def test_report_that_cannot_be_written_leaves_the_one_before(tmp_path):
    path = tmp_path / "report.json"
    path.write_text("before")
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


def test_machine_names_its_processor_and_cores():
    found = machine()
    assert found["cores"] == os.cpu_count()
    assert found["processor"] and found["python"] and found["torch"]


@pytest.mark.skipif("live" not in embedded_models(), reason="its weights are not here")
def test_model_is_identified_by_the_hash_of_its_weights():
    """Of one file its hash; of a model with another's encoder that of both hashes."""
    files = [model_folder("live") / "model.safetensors"]
    files.append(model_folder("default") / "encoder.safetensors")
    hashes = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    both = hashlib.sha256("".join(hashes).encode()).hexdigest()
    assert identified("live") == {"model": "live", "sha256": both}
    weights = (model_folder("mel") / "model.safetensors").read_bytes()
    assert identified("mel") == {"model": "mel", "sha256": hashlib.sha256(weights).hexdigest()}
