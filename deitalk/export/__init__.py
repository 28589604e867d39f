"""Models for other programs: one graph from sound to finished curves.

::

    onnx_file.py       a model as one ONNX file
    finished.py        its modules: a whole recording, or the next frame of live voices
    clip_hearing.py    what they hear of a recording, as operators of a graph
    live_hearing.py    the same of voices that have not ended
"""
