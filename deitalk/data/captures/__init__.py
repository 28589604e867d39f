"""Captured faces: takes of a capture system to a dataset folder, their checks and corrections.

::

    sources.py     files and folders to takes: curves and the recording beside them
    columns.py     tables of named curves of any rig: CSV, JSON, NPZ
    mapping.py     another rig's curves to known controls by a table
    take.py        one file of curves to board channels, with those it can know
    labels.py      actor, emotion and style from options, a pattern, folders or a table
    segments.py    long takes to clips, cut in silence
    splits.py      train, validation and test, by actors or by blocks of time
    imported.py    all of it, into a staged folder
    reports.py     what was imported, and warnings

    sync.py        offset and drift of a take against the model's curves of its sound
    channels.py    channels that are clipped, frozen, jittering; sides that are swapped
    rest.py        an actor's pose at rest, and its removal
    survey.py      measures of all clips, takes and actors
    verdicts.py    rows of `deitalk data check`
    mend.py        `deitalk data check --fix`
"""
