"""What made the shipped weights and the tables of the documents: in a checkout, not in the wheel.

::

    corpus/       synthetic and recorded speech with phone times and curves
    training/     ablations, trainers of small networks, tools that change a model's weights
    comparison/   decoders and encoders of other papers
    evaluation/   measurements that one table or picture needs
    lips/         datasets of measured lips for experiments
    study/        blind comparisons by people
    cli/          the verbs ablate, attention, corpus and study

Nothing outside imports it; `deitalk.installed.research` finds it at run time.
"""
