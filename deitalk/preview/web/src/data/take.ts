/** One performance: curves over time, blended between its neutral and its emotional reading. */

import type { Packed } from "./data";

export interface Point {
  time: number;
  value: number;
}

export interface Warning {
  time: number;
  text: string;
}

export const MAX_INTENSITY = 4;
const SPACING_SECONDS = 0.5;
const LEAST = 0.05;

export class Take {
  readonly title: string;
  readonly fps: number;
  readonly frames: number;
  readonly seconds: number;
  readonly emotions: string[];
  readonly emotion?: Float32Array;
  readonly intensity?: Float32Array;
  points: Point[];
  muted = new Set<string>();
  private readonly values: Float32Array;
  private readonly neutral?: Float32Array;
  /** Warnings from `deitalk.preview.warnings`, which has phones and loudness. */
  private readonly known: Warning[];

  constructor(packed: Packed, private readonly board: Record<string, any>) {
    const { facts, arrays } = packed;
    this.title = facts.title;
    this.fps = facts.fps;
    this.frames = facts.frames;
    this.seconds = facts.frames / facts.fps;
    this.emotions = facts.emotions;
    this.known = facts.warnings;
    this.values = arrays.values as Float32Array;
    this.neutral = arrays.neutral as Float32Array | undefined;
    this.emotion = arrays.emotion as Float32Array | undefined;
    this.intensity = arrays.intensity as Float32Array | undefined;
    this.points = this.heardPoints();
  }

  get isEditable(): boolean {
    return this.neutral !== undefined && this.intensity !== undefined;
  }

  heardPoints(): Point[] {
    if (!this.intensity) return [];
    const count = Math.max(2, Math.ceil(this.seconds / SPACING_SECONDS) + 1);
    const last = (this.frames - 1) / this.fps;
    return Array.from({ length: count }, (_, k) => {
      const time = (last * k) / (count - 1);
      return { time, value: this.intensity![Math.round(time * this.fps)] };
    });
  }

  reset(): void {
    this.points = this.heardPoints();
    this.isEdited = false;
  }

  isEdited = false;

  /** Applied intensity at a frame: of the take, or through the edited points. */
  intensityAt(frame: number): number {
    const predicted = this.intensity ? this.intensity[frame] : 0;
    if (!this.isEdited) return predicted;
    const time = frame / this.fps, p = this.points;
    for (let k = 1; k < p.length; k++) {
      if (time <= p[k].time) {
        const t = (time - p[k - 1].time) / (p[k].time - p[k - 1].time);
        return p[k - 1].value + t * (p[k].value - p[k - 1].value);
      }
    }
    return p[p.length - 1].value;
  }

  /** Mean of the applied intensity over the take; 0 if every frame is neutral. */
  get meanIntensity(): number {
    const n = this.emotions.length, place = this.emotions.indexOf("neutral");
    const isNeutral = !this.emotion?.some((weight, k) => k % n === place && weight < 1);
    if (isNeutral) return 0;
    let sum = 0;
    for (let k = 0; k < this.frames; k++) sum += this.intensityAt(k);
    return sum / this.frames;
  }

  /** All controls at a time, linear between frames. */
  at(seconds: number): Float32Array {
    const place = Math.min(Math.max(seconds * this.fps, 0), this.frames - 1);
    const low = Math.floor(place), high = Math.min(low + 1, this.frames - 1);
    const a = this.frame(low), t = place - low;
    if (!t) return a;
    const b = this.frame(high);
    return a.map((x, k) => x + t * (b[k] - x));
  }

  /** All controls of one frame, within their ranges, muted regions at rest. */
  frame(index: number): Float32Array {
    const n = this.board.controls.length;
    const out = this.values.slice(index * n, index * n + n);
    if (this.isEdited && this.neutral && this.intensity) {
      const factor = this.intensityAt(index) / Math.max(this.intensity[index], LEAST);
      for (let k = 0; k < n; k++) {
        const base = this.neutral[index * n + k];
        out[k] = base + (out[k] - base) * factor;
      }
    }
    for (let k = 0; k < n; k++) {
      out[k] = Math.min(Math.max(out[k], this.board.minimum[k]), this.board.maximum[k]);
      if (this.muted.has(this.board.regions[k])) out[k] = this.board.rest[k];
    }
    return out;
  }

  curve(control: number): number[] {
    return Array.from({ length: this.frames }, (_, k) => this.frame(k)[control]);
  }

  csv(): string {
    const rows = this.points.map((p) => `${p.time.toFixed(6)},${p.value.toFixed(4)}`);
    return `time,intensity\n${rows.join("\n")}\n`;
  }

  /** Warnings: values at their limit for long, jitter, different lengths. */
  warnings(audioSeconds: number): Warning[] {
    const found: Warning[] = [...this.known];
    const n = this.board.controls.length;
    if (audioSeconds && Math.abs(audioSeconds - this.seconds) > 0.1) {
      found.push({ time: 0, text: `curves last ${this.seconds.toFixed(2)} s, the recording ${audioSeconds.toFixed(2)} s` });
    }
    for (let c = 0; c < n; c++) {
      if (this.board.minimum[c] === 0 && this.board.rest[c] === 1) continue;
      const top = this.board.maximum[c], span = top - this.board.minimum[c];
      let run = 0, shakes = 0;
      for (let f = 1; f < this.frames; f++) {
        const x = this.values[f * n + c];
        run = x >= top && this.board.rest[c] < top ? run + 1 : 0;
        if (run === Math.round(this.fps / 2)) {
          found.push({ time: (f - run) / this.fps, text: `${this.board.controls[c]} stays at its limit` });
        }
        if (f < 2) continue;
        const step = x - this.values[(f - 1) * n + c];
        const before = this.values[(f - 1) * n + c] - this.values[(f - 2) * n + c];
        shakes = step * before < 0 && Math.min(Math.abs(step), Math.abs(before)) > 0.15 * span ? shakes + 1 : 0;
        if (shakes === 3) found.push({ time: f / this.fps, text: `${this.board.controls[c]} jitters` });
      }
    }
    return found.sort((a, b) => a.time - b.time).slice(0, 40);
  }
}
