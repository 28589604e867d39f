"""Models for other programs: one graph from sound to finished curves.

::

    onnx_file.py       a model as one ONNX file
    finished.py        its modules: a whole recording, or the next frame of live voices
    sound_measures.py  spectra of frames by operators of a graph
"""
