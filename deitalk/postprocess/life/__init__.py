"""Eyes, brows and head of a face that lives: procedural motion on the voice, from a seed.

::

    voice.py     accents, phrases, questions and pauses of a recording
    tracks.py    shapes over time
    traits.py    random numbers of a take; what distinguishes one character from another
    blinks.py    times and shapes of blinks
    gaze.py      fixations, micro-saccades, aversions
    brows.py     brows, lids and cheeks: accents, questions, drift, left and right
    mouth.py     left and right of the mouth
    head.py      turn and shift of the head
    amounts.py   how much of each is wanted
    motion.py    all of them on the curves of a take

A network that regresses this motion from sound learns its mean: half-closed eyes, still brows. It
is left out of the training curves and added after the rules. Sources are in each file, measured
statistics in docs/life.md. Of the mouth only the difference of its sides is changed.
"""
