"""What made the shipped weights and the tables of the documents: in a checkout, not in the wheel.

::

    corpus/       synthetic and recorded speech with phone times and curves
    training/     ablations, trainers of small networks, tools that change a model's weights
    meshes/       training and scores of mesh models
    comparison/   decoders and encoders of other papers
    evaluation/   scores of a model on a dataset folder; measurements that one table needs
    lips/         datasets of measured lips for experiments
    video/        filmed faces to curves; contact_sheet.py draws the head
    study/        blind comparisons by people
    cli/          the verbs ablate, attention, corpus, evaluate and study, and face sheet

Nothing outside imports it; `deitalk.installed.research` finds it at run time.
"""
