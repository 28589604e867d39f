"""The best path of a chain of phones through a recording (Viterbi 1967), with optional pauses.

Letters: R rows of evidence, P phones, N states.
"""

import numpy as np

from rig.arrays import Bool, Float32, Float64, Int64

BAND = 400
"""States on both sides of the best one that are followed: about half a minute of speech. An hour of
speech takes 170 MB."""


def best_path(
    evidence: Float32, states: Int64, optional: Bool, spans: Int64 | None = None
) -> tuple[Int64, float]:
    """State of each row, from the first state to the last.

    Parameters
    ----------
    evidence : array [shape=(R, P)]
        Logarithms: how well each phone fits each row.
    states : array [shape=(N,)]
        Phone of each state, in their order.
    optional : array [shape=(N,)]
        Whether a state may be left out; neighbours never both.
    spans : array [shape=(N, 2)], optional
        First row, and row after the last, that a state may have.

    Returns
    -------
    path : array [shape=(R,)]
        Rises by 1, or by 2 over an optional state; empty if there is no path.
    score : float
        Sum of the evidence.
    """
    n_rows, n_states = len(evidence), len(states)
    score = np.full(n_states, -np.inf)
    lows, moves = np.zeros(n_rows, np.int64), []
    low, high = 0, min(n_states, BAND)
    score[:2] = np.where(np.arange(2) <= int(optional[0]), 0.0, -np.inf)[:n_states]
    for row in range(n_rows):
        if row:
            best = low + int(score[low:high].argmax())
            low, high = max(low, best - BAND), max(high, min(n_states, best + BAND))
            score[:low] = -np.inf
            score[low:high], move = _advanced(score, optional, low, high)
        else:
            move = np.zeros(high - low, np.int8)
        score[low:high] += evidence[row, states[low:high]]
        if spans is not None:
            outside = (row < spans[low:high, 0]) | (row >= spans[low:high, 1])
            score[low:high][outside] = -np.inf
        lows[row] = low
        moves.append(move)
    last = n_states - 1 - int(optional[-1] and n_states > 1 and score[-2] > score[-1])
    if not np.isfinite(score[last]):
        return np.zeros(0, np.int64), -np.inf
    return _traced(lows, moves, last), float(score[last])


def _advanced(score: Float64, optional: Bool, low: int, high: int) -> tuple[Float64, np.ndarray]:
    """Best scores of the next row, and by how many states each was entered."""
    padded = np.concatenate((np.full(2, -np.inf), score[max(low - 2, 0) : high]))
    padded = padded[-(high - low + 2) :]
    stay, one, two = padded[2:], padded[1:-1], padded[:-2].copy()
    before = np.zeros(high - low, bool)
    start = max(low, 1)
    before[start - low :] = optional[start - 1 : high - 1]
    two[~before] = -np.inf
    move = (one > stay).astype(np.int8)
    best = np.where(move, one, stay)
    skips = two > best
    move[skips] = 2
    return np.where(skips, two, best), move


def _traced(lows: Int64, moves: list[np.ndarray], last: int) -> Int64:
    path = np.empty(len(moves), np.int64)
    state = last
    for row in range(len(moves) - 1, -1, -1):
        path[row] = state
        state -= int(moves[row][state - lows[row]])
    return path
