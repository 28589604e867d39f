"""Eyes, brows and head of a face that lives: procedural motion on the voice, from a seed.

::

    voice.py     accents, phrases, questions and pauses of a recording; shapes over time; random
                 numbers of a take, and what tells characters apart
    eyes.py      times and shapes of blinks; fixations, micro-saccades, aversions
    head.py      brows, lids and cheeks: accents, questions, drift, left and right; turn and shift
                 of the head; the neck
    amounts.py   how much of each is wanted
    motion.py    all of them on the curves of a take; left and right of the mouth

A network that regresses this motion from sound learns its mean: half-closed eyes, still brows. It
is left out of the training curves and added after the rules. Sources are in each file, measured
statistics in docs/life.md. Of the mouth only the difference of its sides is changed.
"""
