"""Many recordings at once: ``deitalk batch``.

::

    lines.py       one recording and its settings; the key of its outputs
    source.py      a manifest or a folder -> lines that can be animated, and those that cannot
    journal.py     SQLite: what was written, from what
    outputs.py     files moved to their names, none of the user's replaced; cloud.py: at a URL
    storage.py     recordings on this machine or wherever fsspec reaches
    messages.py    what goes to a worker and what comes back
    performer.py   one line in a worker: sound -> staged files
    processes.py   worker processes, one model each; cluster.py: machines of a Ray cluster
    orders.py      lines -> orders, results -> rows
    report.py      progress of a run and its tables
    run.py         `animate_batch`: all of it
"""
