"""Compiled loops of the software renderer."""

import subprocess
import sys

import llvmlite.binding as llvm
import numpy as np
import pytest

from rig.face.render.compiled import DIGEST, KERNELS, file_of, run


@pytest.mark.parametrize("name", KERNELS)
def test_bitcode_is_of_its_source(name):
    """After a change: python -m tools.kernels."""
    pytest.importorskip("numba")
    kernels = pytest.importorskip("tools.kernels", reason="tools are in a checkout alone")
    assert file_of(name).read_bytes()[:DIGEST] == kernels.digest()


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize(
    "triple", ["arm64-apple-darwin", "aarch64-unknown-linux-gnu", "x86_64-pc-windows-msvc"]
)
def test_bitcode_becomes_machine_code_of_other_processors(name, triple):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module = llvm.parse_bitcode(file_of(name).read_bytes()[DIGEST:])
    assert not module.triple and not module.data_layout
    module.triple = triple
    machine = llvm.Target.from_triple(triple).create_target_machine(opt=0)
    assert name.encode() in machine.emit_object(module)


def test_normals_of_a_cubes_corner_point_along_its_diagonal():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], np.float32)
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3]], np.uint32)
    found = np.empty_like(corners)
    run("normals", corners, faces, np.array([0, 1, 2, 3, 0], np.uint32), found)
    np.testing.assert_allclose(found[[0, 4]], -(3**-0.5), atol=1e-6)  # and of its copy at a seam


def test_arrays_of_another_type_are_refused():
    with pytest.raises(AssertionError):
        run("normals", *[np.zeros((1, 3))] * 4)


def test_drawing_needs_no_compiler_of_python():
    code = "import sys, rig.face.render.software; print({'numba', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
