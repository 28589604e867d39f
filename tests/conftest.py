"""Fixtures that several test files share."""

import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from copy import deepcopy
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zlib import crc32

import numpy as np
import pytest
import typer.main
import typer.testing
from hypothesis import settings

from rig.files import atomic_write

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

typer.main.get_command = typer.testing._get_command = cache(typer.main.get_command)
"""Of one application the same commands: to build them takes as long as to refuse an option."""

gc.set_threshold(20_000, 20, 20)  # the search for cycles would take a tenth of the time

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background job
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared"
"""Development data beside the checkout (speech, captured curves, meshes); may be absent."""


@pytest.fixture
def disk(tmp_path) -> Iterator[Path]:
    """A file system of 64 MiB; skipped where none can be mounted."""
    folder, mount = tmp_path / "disk", shutil.which("mount")
    folder.mkdir()
    command = [mount, "-t", "tmpfs", "-o", "size=64m", "tmpfs", folder]
    if mount is None or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a tmpfs (root on Linux)")
    yield folder
    subprocess.run(["umount", "-l", folder], check=False)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip("needs the development data in ../shared")
    return SHARED


@pytest.fixture(scope="module")
def empty_pictures() -> Iterator[None]:
    """Trainings write pictures without content; matplotlib takes half of the time of a short one."""

    def draw(path: Path, *shown: object) -> None:
        with atomic_write(path) as beside:
            beside.write_bytes(b"")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deitalk.research.training.pictures.draw_clips", draw)
        patch.setattr("deitalk.evaluation.captures.draw_before_after", draw)
        yield


@pytest.fixture(scope="module")
def one_analysis() -> Iterator[None]:
    """A network analyses equal sound once in a file, which animates one recording in many ways."""
    from deitalk.models.curve_model import DEITalk

    kept, analyse = {}, DEITalk.analyse

    def once(network, sound, n_frames, progress=lambda share: None, gain=1.0):
        key = (network, sound.numpy().tobytes(), n_frames, gain)
        if network.training or key not in kept:
            kept[key] = analyse(network, sound, n_frames, progress, gain)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DEITalk, "analyse", once)
        yield


@pytest.fixture(scope="session")
def opened_once() -> Iterator[None]:
    """Of equal graphs one session in a process, of an equal recording one reading.

    To open a session takes as long as a recording of seconds; it keeps no state.
    """
    from deitalk.models.onnx import network
    from deitalk.pipeline.words import evidence

    def kept(function, key_of):
        """A function that keeps its last 16 results, each with what it was made of."""
        known: dict[Any, Any] = {}

        def call(*given, **named):
            key = key_of(*given, **named)
            if key not in known:
                if len(known) == 16:
                    known.pop(next(iter(known)))
                known[key] = function(*given, **named), given, named
            return known[key][0]

        return call

    def graph_key(graph, path, threads, weights=MappingProxyType({}), *, once=False):
        stored = tuple((name, crc32(np.ascontiguousarray(x))) for name, x in weights.items())
        return graph, threads, once, stored

    def reading_key(read, sound, weights, actor="", progress=None, gain=1.0):
        of = read._session, read._part, network.loudest
        return of, sound.tobytes(), weights.tobytes(), actor, gain

    read = kept(network.OnnxNetwork.read, reading_key)
    features = kept(evidence.phone_features, lambda model, speech: speech.sound.tobytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "open_session", kept(network.open_session, graph_key))
        patch.setattr(network.OnnxNetwork, "read", lambda *a, **named: deepcopy(read(*a, **named)))
        patch.setattr(evidence, "phone_features", features)
        patch.setattr(evidence, "require_model", cache(evidence.require_model))
        yield


THOROUGH = (
    "tests/api/test_animations.py::test_every_format_is_answered_and_not_empty[mp4]",
    "tests/api/test_animations.py::test_every_format_is_answered_and_not_empty[page]",
    "tests/api/test_attacks.py",
    "tests/api/test_drain.py",
    "tests/api/test_jobs.py",
    "tests/api/test_live.py::test_documented_client_of_a_browser",
    "tests/api/test_live.py::test_documented_client_sends_more",
    "tests/api/test_live.py::test_sessions_beyond_the_limit_and_other_sites_are_refused",
    "tests/api/test_lost_workers.py",
    "tests/api/test_malformed.py",
    "tests/api/test_neighbours.py",
    "tests/api/test_pages.py",
    "tests/api/test_parity.py::test_commands_give_the_curves_and_keep_the_settings[batch_line",
    "tests/api/test_parity.py::test_mesh_poses_the_same_curves",
    "tests/api/test_places.py",
    "tests/api/test_protocol.py::test_spans",
    "tests/api/test_queue.py",
    "tests/api/test_schema.py::test_requests_of_the_schema",
    "tests/api/test_store.py",
    "tests/api/test_studio.py",
    "tests/api/test_studio_layers.py",
    "tests/api/test_trouble.py",
    "tests/api/test_worker.py::test_memory_of_an_order_serves_the_next",
    "tests/api/test_worker.py::test_order_beyond_the_memory_is_refused",
    "tests/deitalk/agents/test_face.py::test_a_listener_moves_by_the_voice_of_the_user[48000",
    "tests/deitalk/audio/test_held_sound.py::test_the_mouth_stays_open_while_a_vowel_sounds_and_shuts_after[12 s",
    "tests/deitalk/audio/test_held_sound.py::test_the_mouth_stays_open_while_a_vowel_sounds_and_shuts_after[high",
    "tests/deitalk/audio/test_held_sound.py::test_the_mouth_stays_open_while_a_vowel_sounds_and_shuts_after[swell",
    "tests/deitalk/audio/test_times.py::test_sound_that_starts_after_the_picture_is_silent_until_then[webm-libopus-libvpx-1.5",
    "tests/deitalk/batch/test_processes.py::test_processes_end_with_a_killed_parent",
    "tests/deitalk/batch/test_run.py::test_killed",
    "tests/deitalk/cli/test_dialogue.py::test_two_takes_of_a_dialogue_listen_to_each_other[channels]",
    "tests/deitalk/cli/test_dialogue.py::test_two_takes_of_a_dialogue_listen_to_each_other[subtitles]",
    "tests/deitalk/data/captures/test_mend.py",
    "tests/deitalk/data/captures/test_sync.py::test_takes_at_another_rate",
    "tests/deitalk/data/captures/test_times.py::test_frame_fields_of_every_count",
    "tests/deitalk/data/test_checks.py::test_curves_that_are_late_or_early_are_measured_in_milliseconds[-9",
    "tests/deitalk/data/test_dub.py::test_captured_takes_with_sound_speak_another_recording",
    "tests/deitalk/data/test_dub.py::test_captures_without_a_sound_speak_a_synthetic_voice[livelink/alexdjulin",
    "tests/deitalk/data/test_edited.py::test_delay_and_handles_are_undone",
    "tests/deitalk/data/test_edited.py::test_edited_arkit_shapes_come_back_as_shapes[1",
    "tests/deitalk/data/test_edited.py::test_edits_come_back_at_the_rate_of_the_take[25",
    "tests/deitalk/data/test_edited.py::test_edits_come_back_at_the_rate_of_the_take[48",
    "tests/deitalk/data/test_edited.py::test_edits_come_back_at_the_rate_of_the_take[50",
    "tests/deitalk/data/test_frozen_features.py::test_variants_share_the_features",
    "tests/deitalk/data/test_offset.py",
    "tests/deitalk/evaluation/",
    "tests/deitalk/export/test_onnx_file.py::test_finished_curves_of_a_recording_are_those_of_animate[many pieces]",
    "tests/deitalk/export/test_onnx_file.py::test_finished_frames_of_live_streams",
    "tests/deitalk/export/test_onnx_file.py::test_half_precision",
    "tests/deitalk/live/test_memory.py",
    "tests/deitalk/models/test_mesh_head.py::test_evaluation_scores_every_emotion",
    "tests/deitalk/models/test_mesh_head.py::test_training_separates_emotions",
    "tests/deitalk/models/test_onnx.py::test_a_folder_without_a_graph",
    "tests/deitalk/pipeline/test_curves.py::test_closures_survive_double_intensity[c",
    "tests/deitalk/pipeline/test_curves.py::test_closures_survive_double_intensity[fear",
    "tests/deitalk/pipeline/test_joins.py::test_a_sentence_that_is_cut_has_no_step[emotions2",
    "tests/deitalk/pipeline/test_layers.py::test_another_seed_and_reading_have_the_edits_at_the_same_words[slower",
    "tests/deitalk/postprocess/test_curve_pass.py::test_blocks_of_any_sizes_and_streams_side_by_side_give_the_same[captures-1",
    "tests/deitalk/postprocess/test_curve_pass.py::test_blocks_of_any_sizes_and_streams_side_by_side_give_the_same[none-1",
    "tests/deitalk/postprocess/test_curve_pass.py::test_blocks_of_any_sizes_and_streams_side_by_side_give_the_same[none-2",
    "tests/deitalk/postprocess/test_curve_pass.py::test_blocks_of_any_sizes_and_streams_side_by_side_give_the_same[slow contacts-1",
    "tests/deitalk/preview/test_glb.py",
    "tests/deitalk/preview/test_page.py",
    "tests/deitalk/preview/test_page_layers.py",
    "tests/deitalk/training/test_finetuning.py::test_resumed_run_equals_the_uninterrupted_one[head",
    "tests/deitalk/training/test_from_takes.py",
    "tests/deitalk/training/test_trainer.py::test_compiled_network",
    "tests/deitalk/training/test_tuned_emotions.py",
    "tests/deitalk/training/test_tuning_python.py::test_a_tuned_model_has_its_graph",
    "tests/deitalk/training/test_tuning_python.py::test_range_is_raised_about_the_mean_with_the_same_timing[0.9",
    "tests/rig/retarget/test_methods.py::test_shapes_follow_an_affine_map",
    "tests/test_constraints.py",
    "tests/test_docs_finetuning.py",
    "tests/test_full_disk.py",
    "tests/test_fuzz.py",
    "tests/test_kill.py",
    "tests/test_working_folder.py::test_commands_execute_nothing",
    "tests/test_working_folder.py::test_service_executes_nothing",
)
"""Files and tests of `make test-all` alone, by the start of their names.

They are of browsers, films, servers under attack, kills, fuzzing, and minutes of sound: slow, and seldom broken by a
change that no test of their part notices; and rows of a table of equal cases, of which `make test` has others."""


PASSED = os.environ.get("PASSED")
"""File of tests that passed in runs before, which `.ci/run` does not repeat."""


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Note what passed, where the reports of all processes come together."""
    if PASSED:
        passed = terminalreporter.stats.get("passed", ())
        with open(PASSED, "a", encoding="utf-8") as file:
            file.writelines(f"{report.nodeid}\n" for report in passed)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the tests of `THOROUGH`."""
    if item.nodeid.startswith(THOROUGH):
        item.add_marker("thorough")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Files in the order of `pytest_collection_modifyitems`; tests/api as one, for its server."""
    from xdist.scheduler import LoadFileScheduling

    class Files(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "tests/api" if nodeid.startswith("tests/api/") else super()._split_scope(nodeid)

    config.option.loadscopereorder = False
    return Files(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The short files of tests/rig come last, so that all processes end together."""
    if PASSED and os.path.exists(PASSED):
        done = set(Path(PASSED).read_text(encoding="utf-8").splitlines())
        items[:] = [item for item in items if item.nodeid not in done]
    items.sort(key=lambda item: item.nodeid.startswith("tests/rig/"))
    gc.collect()
    gc.freeze()  # what is imported by now


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Torch's random numbers are those of a new process, whatever ran before."""
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)
