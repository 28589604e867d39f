"""Limits of everything that is read: files, clips, meshes, models.

A reader checks a limit before it allocates or loops, so that a small or hostile file takes little
time and memory. ``docs/limits.md`` lists those that users meet.
"""

KIB, MIB, GIB = 2**10, 2**20, 2**30

# Bytes of a file

CURVES_BYTES = GIB
"""Text table of curves: over an hour of 185 curves at 60 fps."""
JSON_CURVES_BYTES = 512 * MIB
"""Curves as JSON: parsed numbers take several times the memory of their text."""
CUES_BYTES = 8 * MIB
"""Rhubarb cues: three hours are 4 MB as JSON."""
TRACK_BYTES = 32 * MIB
"""Emotion or intensity as CSV: three hours of a take's intensity.csv are 25 MB."""
TRACK_JSON_BYTES = 8 * MIB
"""Emotion or intensity as JSON: parsed objects take thirty times the memory of their text."""
EDIT_BYTES = 8 * MIB
"""Layers of edits as JSON; one of 20 edits has 20 kB."""
TRANSCRIPT_BYTES = 16 * MIB
"""Words or phones with times: three hours of phones as a TextGrid are 12 MB."""
YAML_BYTES = 256 * KIB
"""YAML file or override: parsed at about 1 MB/s; configurations are 2 kB."""
MESH_BYTES = 512 * MIB
"""OBJ, PLY, GLB or NPZ mesh."""
POINTS_BYTES = 4 * MIB
"""Landmark file or shape mapping: both are written by hand."""
CONTROL_SET_BYTES = 4 * MIB
"""Table of a user's own controls; the table of 185 controls is 40 kB."""
MODEL_JSON_BYTES = MIB
"""model.json: the names of the controls and a summary of the training."""
WEIGHTS_BYTES = 4 * GIB
"""model.safetensors: twice the most parameters at four bytes each."""
GRAPH_BYTES = 64 * MIB
"""graph.gz of a model, unpacked; those of the embedded ones are under 2 MB."""
DATASET_TABLE_BYTES = 512 * MIB
"""clips.csv and the tables beside clips of a dataset."""
BATCH_LINES = 1_000_000
"""Lines of a batch; their settings take about 1 kB of memory each."""
HEADER_BYTES = MIB
"""First line of a CSV, header of a PLY file or of model.safetensors."""
STREAM_BYTES = 2 * GIB
"""Recording given as bytes or as a file object: it is held in memory."""
VIDEO_BYTES = 64 * GIB
"""Video of a face, read picture by picture: two hours of a phone's 4K."""

# Archives and sparse files

UNPACKED_BYTES = GIB
"""All arrays of one NPZ archive together."""
ARRAYS = 64
"""Arrays in one NPZ archive; ours hold at most 12."""
EXPANDED_BYTES = 256 * MIB
"""Numbers that any file may expand to, however small: three hours of 185 curves at 30 fps at rest.
Larger results need a file of at least 1/`EXPANSION` of their size."""
SPARSE_BYTES = 32 * MIB
"""The same for USD, which is converted from 251 raw curves: 18 minutes at 30
fps at rest."""
EXPANSION = 100
"""Bytes of numbers for each byte of the file, beyond `EXPANDED_BYTES`."""

# Clips

SECONDS = 3 * 3600.0
"""Recording, cue or key: three hours, the longest take."""
FPS_LOWEST = 1.0
"""Frames per second; below it times without a unit could be numbers of frames."""
FPS_HIGHEST = 300.0
"""Frames per second; the fastest face captures are 240."""
FRAMES = 1_296_000
"""Frames of a clip: three hours at 120 fps."""
GAP_FRAMES = 36_000
"""Frames that a take with time codes may lack: 20 minutes at 30 fps."""
GAP_SHARE = 10
"""Frames that it may last for each that it has, beyond `GAP_FRAMES`."""
VALUES = 2**28
"""Frames times curves: 1 GiB as float32."""
CONTROLS = 4096
"""Controls of one set; MetaHuman's has 251 raw curves."""
KEYS = 1_296_000
"""Keys of an emotion or intensity track: one for each frame of the longest clip."""
TRANSCRIPT_WORDS = 150_000
"""Words, or phones with times, of a transcript: three hours of fast speech have 120,000 phones."""
TRACK_COLUMNS = 256
"""Columns of an emotion or intensity table; a take's has 10."""
VIDEO_PIXELS = 2**26
"""Pixels of one picture of a video; 8K has 2**25."""

# Meshes

VERTICES = 5_000_000
"""Vertices of a mesh; dense scans have one or two million."""
TRIANGLES = 5_000_000
"""Triangles of a mesh."""
SHAPES = 2000
"""Shapes of one set; MetaHuman's head has 800."""
SHAPE_VALUES = 2**27
"""Shapes times vertices times 3: 512 MiB as float32; 52 shapes of 860,000 vertices."""
COORDINATE = 1.0e9
"""Largest coordinate or displacement, in the file's unit: squares stay finite in float32."""
SEQUENCE_BYTES = 4 * GIB
"""Positions of a vertex sequence as float32; morph targets have no such limit."""
PREDICTED_BYTES = 2 * GIB
"""Positions of a vertex sequence that a model predicts, held while it is made."""
NODES = 10_000
"""Nodes of a GLB scene."""
PRIMITIVES = 10_000
"""Primitives of a GLB scene; a head has ten."""
TARGETS = 100_000
"""Morph targets of all primitives of a GLB scene together; each costs some 20 microseconds."""
POINT_NAMES = 1000
"""Landmarks or mapped shapes of one file."""
MAPPED_VALUE = 100.0
"""Value of a control in a shape mapping; ranges end at 1 or 3.2."""
RETARGET_VERTICES = 200_000
"""Vertices of a mesh that shapes are made for; two hundred morph targets of more are unusable."""
HEAD_BYTES = 256 * MIB
"""Head file, packed or not; an embedded head has 6 MB of arrays."""
HEAD_VERTICES = 65_535
"""Vertices of a head that is shown: the page counts them in 16 bits."""
HEAD_MOVES = 12_000_000
"""Displacements of all shapes of a head together; the page holds 14 bytes of each."""
PICTURE_PIXELS = 2**26
"""Pixels of one texture: 8192 x 8192."""

# Structured text

NESTING = 32
"""Levels of lists and mappings in JSON and YAML; our files have four, GLB ten."""
YAML_VALUES = 50_000
"""Scalars, lists and mappings of a YAML text, aliases written out; a configuration has 200."""
SCALAR_CHARACTERS = 4096
"""One scalar of YAML; numbers of many parts are parsed in quadratic time."""
MESSAGE_CHARACTERS = 400
"""An error message; longer ones lose their middle."""
QUOTED_CHARACTERS = 60
"""A value quoted in a message."""

# Networks

PARAMETERS = 500_000_000
"""Parameters of a network; wav2vec 2.0 large has 317 million."""
WIDTH = 8192
"""Channels, features or units of one layer; wav2vec 2.0 large has 4096."""
LAYERS = 32
"""Layers of one stack; wav2vec 2.0 large has 24."""
MOTION_LAYERS = 10
"""Layers of the motion encoder: each doubles the dilation, that of the tenth is 512 frames."""
RECURRENT_LAYERS = 8
"""Layers of one BiLSTM, and BiLSTMs along rig frames."""
KERNEL = 255
"""Frames a convolution or query spans."""
DILATION = 1024
"""Frames between the taps of a convolution."""
MEL_BINS = 512
"""Bins of a mel spectrum."""
TAPERS = 8
"""Windows whose spectra are averaged."""
WINDOW_SECONDS = 1.0
"""Length of one spectrum, seconds."""
SPECTRA_PER_SECOND = 1000.0
"""Rate of spectra; every spectrum is computed."""
WINDOW_FRAMES = 1024
"""Spectra within one frame's attention or convolution."""
SALIENCY_FRAMES = 1800
"""Frames that an embedding is pooled over: one minute; the work grows with it."""
TRAINING_FRAMES = 36_000
"""Frames of a training window: 20 minutes."""
BATCH = 65_536
"""Clips or frames of a training batch."""
WORKERS = 256
"""Processes that prepare training batches."""
SEED = 2**63 - 1
"""Seed of a random generator; the lowest is 0."""
SPEAKERS = 256
"""Speakers, each with a template mesh, of one mesh model."""
TENSORS = 10_000
"""Tensors of a model file."""
TRAINING_PASSES = 1.0e6
"""Epochs of a training."""
TRAINING_STEPS = 10**9
"""Steps of a training."""
MOST_DELAY = 240
"""Frames by which a face may be late or early against its sound."""
MOST_HANDLES = 1000
"""Frames that may be added before and after."""
