"""Fit of the phones' evidence on planted features; labels by hand."""

import numpy as np

from deitalk.postprocess.phones import PHONES
from deitalk.research.training.phone_evidence import Rows, fit, labels, main, score


def planted(seed, count=6000):
    """Three phones in runs of six rows, each with a feature of its own and one that is a trap."""
    rng = np.random.default_rng(seed)
    chosen = np.repeat(rng.choice([PHONES.index(p) for p in ("M", "F", "AA")], count // 6), 6)
    features = rng.normal(0, 0.3, (count, 4)).astype(np.float16)
    for column, name in enumerate(("M", "F", "AA")):
        features[chosen == PHONES.index(name), column] += 1
    features[:, 3] += 50  # far from 0, without meaning
    return Rows(features, chosen)


def test_fit_finds_phones_of_other_rows():
    found = fit(planted(0))
    scores = score(found, planted(1))
    assert scores["phone"] > 0.9 and scores["lips"] > 0.9
    assert found.weights["weight"].shape == (len(PHONES), 12)
    mixed = planted(0)
    shuffled = mixed._replace(phones=np.random.default_rng(2).permutation(mixed.phones))
    assert score(fit(shuffled), planted(1))["phone"] < 0.6


def test_labels_are_the_phones_at_each_row():
    """Row k is at k / 60 s; the last phone lasts to the end."""
    phones = [(0.0, 0.05, "SIL"), (0.05, 0.1, "M"), (0.1, 0.12, "AA")]
    names = [PHONES[i] for i in labels(phones, 9)]
    assert names == ["SIL"] * 3 + ["M"] * 3 + ["AA"] * 3


def test_command_names_a_folder_without_clips(tmp_path, capsys):
    assert main(["--data", str(tmp_path)]) == 1
    assert "holds no clips.csv" in capsys.readouterr().err
