/** Warnings that need no recording: values at their limit for long, jitter, different lengths. */

import type { Board } from "./board";

export interface Warning {
  time: number;
  text: string;
}

interface Length {
  fps: number;
  frames: number;
  seconds: number;
  audioSeconds: number;
}

const MOST = 40;
const STEP_SHARE = 0.15;

/** The warnings of `deitalk.preview.source`, which has phones and loudness, and those found here. */
export function findWarnings(values: Float32Array, length: Length, board: Board, known: Warning[]): Warning[] {
  const found = [...known], { fps, frames, seconds, audioSeconds } = length;
  const n = board.controls.length;
  const text = `curves last ${seconds.toFixed(2)} s, the recording ${audioSeconds.toFixed(2)} s`;
  if (audioSeconds && Math.abs(audioSeconds - seconds) > 0.1 && !known.some((other) => other.text === text)) {
    found.push({ time: 0, text });
  }
  for (let c = 0; c < n; c++) {
    if (board.minimum[c] === 0 && board.rest[c] === 1) continue;
    const top = board.maximum[c], least = STEP_SHARE * (top - board.minimum[c]);
    let run = 0, shakes = 0;
    for (let f = 1; f < frames; f++) {
      const x = values[f * n + c];
      run = x >= top && board.rest[c] < top ? run + 1 : 0;
      if (run === Math.round(fps / 2)) {
        found.push({ time: (f - run) / fps, text: `${board.controls[c]} stays at its limit` });
      }
      if (f < 2) continue;
      const step = x - values[(f - 1) * n + c], before = values[(f - 1) * n + c] - values[(f - 2) * n + c];
      shakes = step * before < 0 && Math.min(Math.abs(step), Math.abs(before)) > least ? shakes + 1 : 0;
      if (shakes === 3) found.push({ time: f / fps, text: `${board.controls[c]} jitters` });
    }
  }
  return found.sort((a, b) => a.time - b.time).slice(0, MOST);
}
