"""Many recordings at once: ``deitalk batch``.

::

    lines.py       one recording and its settings; the key of its outputs; orders, outcomes, rows;
                   progress of a run and its tables
    source.py      a manifest or a folder -> lines that can be animated, and those that cannot
    outputs.py     SQLite journal of what was written, from what; files moved to their names, none
                   of the user's replaced
    recordings.py  state and content of recordings
    cloud.py       files at URLs; outputs at a URL are a folder of the cache that is copied
    processes.py   worker processes, one model each: sound -> staged files
    cluster.py     machines of a Ray cluster in their place
    run.py         lines -> orders, results -> rows; `animate_batch`: all of it
"""
