"""Kills commands at random moments and checks the remaining files.

::

    python -m tests.kill --rounds 200 --command train

Each round starts the command in a separate process, ends it by signal 9 (every fourth time
by SIGTERM), and checks that

- no file is half-written under a final name: every file can be read to its end,
- the user's files, in the target and beside it, are the same bytes,
- no process of the command is left,
- the same command again succeeds with the result of an uninterrupted one,
- no hidden temporary file is left then (after SIGTERM: at once).

::

    processes.py   a process forked from this one, with all imports done
    contents.py    reading files to their end, comparing folders
    commands.py    the commands, their inputs and the user's files
    rounds.py      one round, many rounds
"""
