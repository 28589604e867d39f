"""Eyes, brows and head of a face that lives: procedural motion on the voice, from a seed.

::

    voice.py     accents, phrases, questions and pauses of a recording; seeds, and what tells
                 characters apart
    other.py     the voice of the one whom a face listens to
    draws.py     random numbers, slow noise and events of streams side by side
    eyes.py      times and shapes of blinks; fixations, saccades, aversions, vergence
    face.py      brows, lids, cheeks, smiles: accents, questions, gestures of a calm face
    head.py      turn and shift of the head; the neck
    breath.py    breath through the mouth before phrases
    amounts.py   how much of each is wanted
    listener.py  where the listener is
    motion.py    all of them for streams side by side
    play.py      what they move on the curves, by the emotion; left and right of the mouth

A network that regresses this motion from sound learns its mean: half-closed eyes, still brows. It
is left out of the training curves and added after the rules. Sources are in each file, measured
statistics in docs/life.md. Of the mouth it changes the difference of the sides, and adds small
smiles of a calm face and breaths.
"""
