"""Voice activity detectors compared on labelled speech, in noise and music.

``python -m deitalk.evaluation.voice_activity DATA --noise FOLDER`` prints two Markdown tables.
Labels come from the phone times of a dataset folder. The operating point of
the detectors of other packages is chosen on the speakers of the split ``train``; those of
``validation`` and ``test`` are scored.
"""
