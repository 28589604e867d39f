"""Captured faces: takes of a capture system to a dataset folder, their checks and corrections.

::

    sources.py     files and folders to takes: curves and the recording beside them;
                   actor, emotion and style from options, a pattern, folders or a table
    columns.py     tables of named curves of any rig: CSV, JSON, NPZ;
                   another rig's curves to known controls by a table
    take.py        one file of curves to board channels, with those it can know
    segments.py    takes to clips, cut in pauses
    splits.py      train, validation and test, by actors or by blocks of time
    imported.py    all of it, into a staged folder; import_report.py says what it did
    rig_of.py      a rig from names of columns

    (deitalk.data.offset: offset and drift of a take against the curves of its sound)
    channels.py    faults of the channels of a clip
    survey.py      measures of all clips, takes and actors
    verdicts.py    rows of `deitalk data check`
    mend.py        its `--fix`
"""
