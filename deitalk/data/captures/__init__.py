"""Import of captured faces: takes of a capture system to a dataset folder, and its mending.

::

    sources.py     files and folders to takes: curves and the recording beside them
    columns.py     tables of named curves of any rig: CSV, JSON, NPZ
    mapping.py     another rig's curves to known controls by a table
    take.py        one file of curves to board channels, with those it can know
    labels.py      actor, emotion and style from options, a pattern, folders or a table
    segments.py    long takes to clips, cut in silence
    splits.py      train, validation and test, by actors or by blocks of time
    reports.py     what was imported, and warnings
    imported.py    all of it, into a staged folder
"""
