"""The script for Maya against a substitute with the documented commands."""

import ast
import re
import sys
from types import ModuleType

import numpy as np
import pytest

from rig import RigCurves, default_controls, write_curves
from tests.splines import hermite

BOARD = default_controls()
KEYED = [c for c in BOARD.controls if c.role in ("driver", "master")]
OLDER = {
    "CTRL_C_tongue_move": "CTRL_C_tongue",
    "CTRL_C_tongue_wideNarrow": "CTRL_C_tongue_narrowWide",
    "CTRL_C_tongue_tipMove": "CTRL_C_tongue_tip",
    "CTRL_C_tongue_bendTwist": "CTRL_C_tongue_roll",
}
NEWER = {f"CTRL_{s}_mouth_thicknessInward{h}" for s in "LR" for h in "UD"}
NEWER |= {"CTRL_C_tongue_roll", "CTRL_C_tongue_thickThin"}
"""Controls that boards before 2024 lack; their CTRL_C_tongue_roll is today's bendTwist."""


class Maya:
    """maya.cmds of a scene: nodes with attributes; keys are linear.

    Rules of the documentation: ``ls`` takes patterns whose star matches no colon; a locked attribute is
    not settable; ``setKeyframe`` replaces a key at its time; times are in the scene's unit.
    """

    def __init__(self, nodes, fps=24.0, selection=(), locked=()):
        self.nodes, self.fps, self.selection, self.locked = set(nodes), fps, selection, locked
        self.keys, self.chunks, self.range = {}, 0, [1.0, 120.0]
        self.slopes = {}

    def ls(self, *patterns, type=None, selection=False):
        if selection:
            return list(self.selection)
        regexes = ["[^:]*".join(map(re.escape, p.split("*"))) for p in patterns]
        return [
            f"|root|{n}" for n in sorted(self.nodes) if any(re.fullmatch(r, n) for r in regexes)
        ]

    def objExists(self, name):
        node, _, attribute = name.partition(".")
        return node in self.nodes and attribute in ("", "translateX", "translateY")

    def getAttr(self, plug, settable):
        assert settable and self.objExists(plug)
        return plug not in self.locked

    def playbackOptions(self, query=False, edit=False, minTime=None, maxTime=None):
        if query:
            return self.range[0 if minTime else 1]
        self.range[1] = maxTime

    def undoInfo(self, openChunk=False, closeChunk=False, chunkName=""):
        self.chunks += openChunk - closeChunk

    def cutKey(self, node, attribute, time, clear):
        keys = self.keys.get(f"{node}.{attribute}", {})
        for at in [at for at in keys if time[0] <= at <= time[1]]:
            del keys[at]

    def setKeyframe(self, node, attribute, time, value, inTangentType, outTangentType):
        assert inTangentType == outTangentType and inTangentType in ("linear", "fixed")
        assert f"{node}.{attribute}" not in self.locked
        self.keys.setdefault(f"{node}.{attribute}", {})[time] = value

    def at(self, plug, times):
        keys = sorted(self.keys[plug].items())
        if plug in self.slopes:
            slopes = [self.slopes[plug][time] for time, _ in keys]
            return hermite(*zip(*keys, strict=True), *zip(*slopes, strict=True), times)
        return np.interp(times, *zip(*keys, strict=True))


class MSelectionList:
    def add(self, plug):
        self.plug = plug
        return self

    def getPlug(self, index):
        return self.plug


def curve_of(maya):
    class MFnAnimCurve:
        """Slopes are value by seconds where units are not converted."""

        def __init__(self, plug):
            self.plug, self.times = plug, sorted(maya.keys[plug])
            maya.slopes[plug] = {time: [None, None] for time in self.times}

        def setIsWeighted(self, is_weighted):
            assert not is_weighted

        def find(self, time):
            return self.times.index(time.value)

        def setTangentsLocked(self, index, is_locked):
            assert not is_locked

        def setTangent(self, index, x, y, is_in, change, converts):
            assert change is None and not converts
            maya.slopes[self.plug][self.times[index]][not is_in] = y / x / maya.fps

    return MFnAnimCurve


def api_of(maya):
    """Stand-ins of OpenMaya and OpenMayaAnim."""
    om, anim = ModuleType("maya.api.OpenMaya"), ModuleType("maya.api.OpenMayaAnim")

    class MTime:
        kSeconds = "s"

        def __init__(self, value, unit):
            assert unit in ("s", "ui")
            self.value = value

        @staticmethod
        def uiUnit():
            return "ui"

        def asUnits(self, unit):
            assert unit == "ui"
            return self.value * maya.fps

    om.MTime, om.MSelectionList, anim.MFnAnimCurve = MTime, MSelectionList, curve_of(maya)
    return om, anim


def run(path, maya, monkeypatch, **options):
    """Run the file as Maya's Script Editor would."""
    package, api = ModuleType("maya"), ModuleType("maya.api")
    api.OpenMaya, api.OpenMayaAnim = api_of(maya)
    package.cmds, package.api = maya, api
    modules = {"maya": package, "maya.api": api, "maya.api.OpenMaya": api.OpenMaya}
    for name, module in (modules | {"maya.api.OpenMayaAnim": api.OpenMayaAnim}).items():
        monkeypatch.setitem(sys.modules, name, module)
    scope = {"__name__": "dropped"}
    exec(compile(path.read_text(), str(path), "exec"), scope)
    return scope["key_board"](**options) if options else scope["onMayaDroppedPythonFile"]("x")


def board(namespace="", older=False):
    names = {c.ue_control for c in KEYED}
    if older:
        names -= NEWER
        names = {OLDER.get(name, name) for name in names}
    return {namespace + name for name in names}


@pytest.fixture
def curves(rng):
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (20, 185)).astype(np.float32)
    values[:, BOARD.index("CTRL_L_ear_up.ty")] = 0.25
    values[5:9, BOARD.index("CTRL_C_jaw.ty")] = 0.5
    return RigCurves(values, BOARD.names, 30)


@pytest.fixture
def script(tmp_path, curves):
    report = write_curves(tmp_path / "speech.maya.py", curves)
    assert report.format == "maya"
    return tmp_path / "speech.maya.py"


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0])
def test_board_moves_as_the_curves_in_true_time(script, curves, monkeypatch, fps):
    maya = Maya(board(), fps)
    run(script, maya, monkeypatch)
    times = 1 + np.arange(20) / 30 * fps
    for control in KEYED:
        attribute = {"x": "translateX", "y": "translateY"}[control.name[-1]]
        found = maya.at(f"{control.ue_control}.{attribute}", times)
        np.testing.assert_allclose(found, curves[control.name], atol=5.1e-5)
    assert len(maya.keys) == len(KEYED) == 176 and maya.chunks == 0
    assert len(maya.keys["CTRL_L_ear_up.translateY"]) == 1
    assert len(maya.keys["CTRL_C_jaw.translateY"]) == 18  # two within a run of one value


def test_few_keys_stay_near_the_curves(tmp_path, monkeypatch):
    place = np.sin(np.linspace(0, 6, 120))[:, None].astype(np.float32)
    values = np.clip(BOARD.rest + 0.5 * place, BOARD.minimum, BOARD.maximum).astype(np.float32)
    smooth = RigCurves(values, BOARD.names, 30)
    write_curves(tmp_path / "smooth.maya.py", smooth)
    maya = Maya(board(), 30.0)
    run(tmp_path / "smooth.maya.py", maya, monkeypatch, tolerance=0.01)
    times = 1 + np.arange(120)
    found = maya.at("CTRL_C_jaw.translateY", times)
    np.testing.assert_allclose(found, smooth["CTRL_C_jaw.ty"], atol=0.01 + 5.1e-5)
    assert len(maya.keys["CTRL_C_jaw.translateY"]) < 12
    still = Maya(board(), 24.0)
    run(tmp_path / "smooth.maya.py", still, monkeypatch, tolerance=0.6, still=False)
    assert all(len(keys) > 1 for keys in still.keys.values())


def test_the_script_has_no_annotations_for_python_2(script):
    tree = ast.parse(script.read_text())
    found = [node for node in ast.walk(tree) if isinstance(node, ast.AnnAssign | ast.arg)]
    assert len(found) > 10
    assert not [node for node in found if getattr(node, "annotation", None) is not None]


def test_second_run_replaces_the_keys_and_keeps_others(script, monkeypatch):
    maya = Maya(board())
    maya.keys["CTRL_C_jaw.translateY"] = {3.0: 9.0, 500.0: 0.125}
    run(script, maya, monkeypatch, start=1.0)
    first = dict(maya.keys["CTRL_C_jaw.translateY"])
    run(script, maya, monkeypatch, start=1.0)
    assert maya.keys["CTRL_C_jaw.translateY"] == first and first[500.0] == 0.125
    assert 9.0 not in first.values()


def test_board_of_a_namespace_is_found_or_chosen(script, monkeypatch):
    maya = Maya(board("Anna:"))
    run(script, maya, monkeypatch)
    assert all(name.startswith("Anna:") for name in maya.keys)
    both = board("Anna:") | board("film:Ben:")
    with pytest.raises(RuntimeError, match="select a control of one board: Anna:, film:Ben:"):
        run(script, Maya(both), monkeypatch)
    maya = Maya(both, selection=["film:Ben:CTRL_L_eye"])
    run(script, maya, monkeypatch)
    assert all(name.startswith("film:Ben:") for name in maya.keys)
    with pytest.raises(RuntimeError, match="no CTRL_C_jaw; import the facial board"):
        run(script, Maya(["pCube1"]), monkeypatch)


def test_older_board_gets_its_own_names(script, curves, monkeypatch):
    maya = Maya(board(older=True))
    skipped = run(script, maya, monkeypatch, start=0.0)
    assert set(skipped) == {f"{name}.translateY" for name in NEWER}
    times = np.arange(20) / 30 * 24
    found = maya.at("CTRL_C_tongue_roll.translateY", times)
    np.testing.assert_allclose(found, curves["CTRL_C_tongue_bendTwist.ty"], atol=5.1e-5)


def test_locked_channels_are_left_out(script, monkeypatch):
    maya = Maya(board(), locked=["CTRL_C_jaw.translateX"])
    assert run(script, maya, monkeypatch, start=0.0) == ["CTRL_C_jaw.translateX"]
    assert maya.range == [1.0, 120.0]


def test_script_has_no_syntax_of_python_3_alone(script):
    text = script.read_text()
    assert text.isascii() and not re.search(r'\bf"|->|:=|nonlocal|print [^(]', text)
