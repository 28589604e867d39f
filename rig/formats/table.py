"""The table of formats: names and suffixes to readers and writers."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from rig.controls import DEFAULT_ID, ControlSet
from rig.conversion.arkit import ARKIT_ID, RAW_ID
from rig.conversion.avatars import AVATARS, gesture_controls
from rig.curves import RigCurves
from rig.errors import FormatError
from rig.formats import (
    audio2face,
    curves_csv,
    curves_json,
    emoface_txt,
    livelink_csv,
    maya_script,
    rhubarb,
    rigmapper_csv,
    unity_anim,
    unreal_json,
)

Reader = Callable[[Path, ControlSet | None, float | None], RigCurves]
Writer = Callable[..., None]
Header = tuple[str, ...]
ALL_TRACKS = ("emotion", "intensity", "head")


@dataclass(frozen=True)
class Format:
    """One file format.

    Parameters
    ----------
    name : str
        Name of the format.
    suffixes : tuple of str
        Ends of file names that mean this format, the longest match wins.
    description : str
        One line.
    read, write : callable, optional
        None if the format is only written or only read.
    control_set : str, optional
        Control set of the file; curves are converted to it. None: any.
    also : tuple of str
        Further control sets that the file can have; curves of these are not converted.
    tracks : tuple of str
        Names of the tracks that are kept: emotion, intensity, head.
    begins : tuple of str
        First cells (lower case) of a CSV of this format, by which it is recognised.
    note : callable, optional
        A line on path and curves: what the writer adds, or an empty one.
    shows : callable, optional
        Names of the controls of the board that it shows. None: all of its control set.
    options : tuple of str
        Keywords that the writer takes: digits after the point, sound (the path that the file
        names) and seconds (its length), start (time of day of the first frame, seconds), identity.
    """

    name: str
    suffixes: tuple[str, ...]
    description: str
    read: Reader | None = None
    write: Writer | None = None
    control_set: str | None = None
    also: tuple[str, ...] = ()
    tracks: tuple[str, ...] = ()
    begins: tuple[str, ...] = ()
    note: Callable[[Path, RigCurves], str] | None = None
    shows: Callable[[], Iterable[str]] | None = None
    options: tuple[str, ...] = ()


def _late(module: str, name: str) -> Callable[..., Any]:
    """Return a function of a module that is loaded when it is called: heads, scipy, pxr."""

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(import_module(f"rig.formats.{module}"), name)(*arguments, **options)

    return call


def shown_controls() -> frozenset[str]:
    """Return the controls that the shapes of the embedded heads show."""
    from rig.retarget.morph_head import shown_controls as shown

    return shown()


def keyed_controls() -> list[str]:
    """Return the controls that scripts in Unreal and Maya key."""
    return [control.name for control in unreal_json.keyed_controls()]


FORMATS: tuple[Format, ...] = (
    Format(
        "csv",
        (".csv",),
        "frame, time and one column per control",
        curves_csv.read,
        curves_csv.write,
        options=("digits",),
    ),
    Format(
        "json",
        (".json",),
        "schema deitalk.curves/1, with tracks",
        curves_json.read,
        curves_json.write,
        tracks=ALL_TRACKS,
        options=("digits",),
    ),
    Format(
        "npz",
        (".npz",),
        "numpy archive, exact, with tracks",
        curves_json.read_archive,
        curves_json.write_archive,
        tracks=ALL_TRACKS,
    ),
    Format(
        "raw-csv",
        (".raw.csv",),
        "frame, time and the 251 raw CTRL_expressions curves",
        curves_csv.read,
        curves_csv.write,
        RAW_ID,
        options=("digits",),
    ),
    Format(
        "rigmapper",
        (".rigmapper.csv",),
        "Unreal RigMapper keys of the raw curves: curve_name, frame_number, value",
        rigmapper_csv.read,
        rigmapper_csv.write,
        RAW_ID,
        begins=("curve_name", "frame_number"),
    ),
    Format(
        "livelink",
        (".livelink.csv", "_cal.csv"),
        "Live Link Face CSV, 61 ARKit columns (lossy)",
        livelink_csv.read,
        livelink_csv.write,
        ARKIT_ID,
        tracks=("head",),
        begins=("timecode", "blendshapecount"),
        note=livelink_csv.notes,
        options=("start",),
    ),
    Format(
        "livelink-raw",
        (".livelink-raw.csv",),
        "Live Link CSV of a MetaHuman subject: the 251 raw curves, head and versions",
        livelink_csv.read,
        livelink_csv.write,
        RAW_ID,
        tracks=("head",),
        note=livelink_csv.notes,
        options=("start",),
    ),
    Format(
        "a2f",
        (".a2f.csv", "animation_frames.csv"),
        "animation_frames.csv of NVIDIA Audio2Face-3D, 52 ARKit shapes (lossy)",
        audio2face.read,
        audio2face.write,
        ARKIT_ID,
        begins=("", "timecode"),
    ),
    Format(
        "a2f-json",
        (".a2f.json",),
        "facsNames and weightMat of the Audio2Face application: ARKit or an avatar (lossy)",
        audio2face.read_json,
        audio2face.write_json,
        ARKIT_ID,
        also=AVATARS,
        options=("sound",),
    ),
    Format(
        "unity",
        (".anim",),
        "Unity animation clip of blend shapes: ARKit's or an avatar's names (lossy)",
        unity_anim.read,
        unity_anim.write,
        ARKIT_ID,
        also=AVATARS,
    ),
    Format(
        "emoface",
        (".txt",),
        "EmoFace and MEDTalk, 174 board values per line; reading needs fps",
        emoface_txt.read,
        emoface_txt.write,
        DEFAULT_ID,
        shows=emoface_txt.columns,
    ),
    Format(
        "unreal",
        (".unreal.json",),
        "raw curves and board keys for the script inside Unreal",
        unreal_json.read,
        unreal_json.write,
        DEFAULT_ID,
        shows=keyed_controls,
        tracks=("head",),
        options=("digits", "start"),
    ),
    Format(
        "maya",
        (".maya.py",),
        "script that keys the MetaHuman face board in Maya: drag it into the viewport",
        maya_script.read,
        maya_script.write,
        DEFAULT_ID,
        shows=keyed_controls,
    ),
    Format(
        "visemes",
        (".visemes.json",),
        "weights of the 15 Oculus visemes",
        rhubarb.read,
        rhubarb.write,
        DEFAULT_ID,
        shows=gesture_controls,
    ),
    Format(
        "rhubarb-json",
        (".rhubarb.json",),
        "Rhubarb mouth cues A to H and X",
        rhubarb.read_json_cues,
        rhubarb.write_json,
        DEFAULT_ID,
        shows=gesture_controls,
        options=("sound", "seconds"),
    ),
    Format(
        "rhubarb-tsv",
        (".tsv",),
        "Rhubarb mouth cues, tab separated",
        rhubarb.read_tsv,
        rhubarb.write_tsv,
        DEFAULT_ID,
        shows=gesture_controls,
        options=("seconds",),
    ),
    Format(
        "rhubarb-dat",
        (".dat",),
        "Rhubarb mouth cues for Moho and OpenToonz; reading takes fps, 24",
        rhubarb.read_dat,
        rhubarb.write_dat,
        DEFAULT_ID,
        shows=gesture_controls,
        options=("seconds",),
    ),
    Format(
        "rhubarb-xml",
        (".xml",),
        "Rhubarb mouth cues, XML",
        rhubarb.read_xml,
        rhubarb.write_xml,
        DEFAULT_ID,
        shows=gesture_controls,
        options=("sound", "seconds"),
    ),
    Format(
        "glb",
        (".glb",),
        "our head with morph targets and their animation; --rig arkit: ARKit's 52 names",
        _late("glb", "read"),
        _late("glb", "write"),
        DEFAULT_ID,
        also=(ARKIT_ID,),
        tracks=("head",),
        shows=shown_controls,
        options=("identity",),
    ),
    Format(
        "fbx",
        (".fbx",),
        "the same as FBX, written and read by Blender (extra fbx)",
        _late("fbx", "read"),
        _late("fbx", "write"),
        DEFAULT_ID,
        also=(ARKIT_ID,),
        tracks=("head",),
        shows=shown_controls,
        options=("identity",),
    ),
    Format(
        "vrma",
        (".vrma",),
        "animation of any VRM avatar: vowels and blinks, ARKit's shapes, head, gaze (lossy)",
        _late("vrma", "read"),
        _late("vrma", "write"),
        DEFAULT_ID,
        tracks=("head",),
        note=_late("vrma", "note"),
    ),
    Format(
        "usd",
        (".usd", ".usda", ".usdc", ".usdz"),
        "our head as UsdSkel blend shapes, textured in .usdz; raw curves (extra usd)",
        _late("usd", "read"),
        _late("usd", "write"),
        DEFAULT_ID,
        tracks=("head",),
        options=("identity",),
    ),
)


def writable_suffixes() -> tuple[str, ...]:
    """Return the ends of file names that curves are written to."""
    return tuple(suffix for known in FORMATS if known.write for suffix in known.suffixes)


def find_format(
    path: Path, name: str | None = None, *, readable: bool = False, writable: bool = False
) -> Format:
    """Return the format of a name, or of a path's suffix.

    Raises
    ------
    FormatError
        If there is none, or it cannot be read or written as required; the known ones are listed.
    """
    fits = [f for f in FORMATS if (f.read or not readable) and (f.write or not writable)]
    by_name: Mapping[str, Format] = {f.name: f for f in fits}
    if name is not None:
        if name not in by_name:
            raise FormatError(f"unknown format {name!r}; known: {', '.join(by_name)}")
        return by_name[name]
    endings = [(s, f) for f in fits for s in f.suffixes if path.name.lower().endswith(s)]
    if not endings:
        known = ", ".join(s for f in fits for s in f.suffixes)
        raise FormatError(f"{path}: no format has the suffix {path.suffix!r}; known: {known}")
    return max(endings, key=lambda ending: len(ending[0]))[1]


def format_of_header(header: Header) -> str | None:
    """Return the format whose CSV begins with a header's first cells, or None."""
    cells = tuple(cell.lower() for cell in header)
    for known in FORMATS:
        if known.begins and cells[: len(known.begins)] == known.begins:
            return known.name
    return None
