/** One performance: curves over time, blended between its neutral and its emotional reading. */

import type { Board } from "./board";
import { type Edit, factorAt, gainsOf, NO_EDIT } from "./edit";
import { headWithLayers, type Layer, withLayers } from "./layers";
import type { Packed } from "./packed";
import { findWarnings, type Warning } from "./warnings";

export const MAX_INTENSITY = 4;

/** Curves for the intensity of an edit, computed by the service: they replace the blend. */
interface Exact {
  points: Edit["points"];
  take: Take;
}

export class Take {
  readonly title: string;
  readonly fps: number;
  readonly frames: number;
  readonly seconds: number;
  readonly audioSeconds: number;
  readonly emotions: string[];
  /** Weights (T, emotions); undefined if they are unknown. */
  readonly emotion?: Float32Array;
  /** Applied intensity of the reading, before any edit. */
  readonly intensity?: Float32Array;
  readonly warnings: Warning[];
  /** 1 in speech, else 0 (T,); undefined without a recording. */
  private readonly speaking?: Uint8Array;
  private readonly values: Float32Array;
  private readonly neutral?: Float32Array;
  /** Turn and shift of the head (T, 6); undefined if it is unknown. */
  private readonly head?: Float32Array;
  private edit: Edit = NO_EDIT;
  private gains: number[] = [];
  private exact?: Exact;

  /** A fixed take, such as a captured reference, follows no edit. */
  constructor(packed: Packed, readonly board: Board, readonly isFixed = false) {
    const { facts, arrays } = packed;
    this.title = facts.title;
    this.fps = facts.fps;
    this.frames = facts.frames;
    this.seconds = facts.frames / facts.fps;
    this.audioSeconds = facts.audioSeconds ?? 0;
    this.emotions = facts.emotions;
    this.values = arrays.values as Float32Array;
    this.neutral = arrays.neutral as Float32Array | undefined;
    this.head = arrays.head as Float32Array | undefined;
    this.emotion = arrays.emotion as Float32Array | undefined;
    this.intensity = arrays.intensity as Float32Array | undefined;
    this.speaking = arrays.speaking as Uint8Array | undefined;
    this.warnings = findWarnings(this.values, this, board, facts.warnings ?? []);
    this.apply(NO_EDIT);
  }

  /** Whether the intensity can be changed here. */
  get isEditable(): boolean {
    return this.neutral !== undefined && this.intensity !== undefined;
  }

  /** Whether the shown curves are the linear blend for an edit, not the rules of `animate`. */
  get isBlend(): boolean {
    return this.edit.points.length > 0 && !this.isExact;
  }

  private get isExact(): boolean {
    return this.exact?.points === this.edit.points;
  }

  apply(edit: Edit): void {
    if (this.isFixed) edit = NO_EDIT;
    this.edit = edit;
    const gains = gainsOf(edit);
    this.gains = this.board.regions.map((region) => gains[region] ?? 1);
  }

  /** Take curves of the service for the points of an edit; they hold while the points stay. */
  setExact(points: Edit["points"], exact: Take): void {
    if (exact.values.length === this.values.length) this.exact = { points, take: exact };
  }

  /** Applied intensity at a frame: that of the reading times the factor of the edit. */
  intensityAt(frame: number, points = this.edit.points): number {
    if (!this.intensity) return 0;
    return Math.min(this.intensity[frame] * factorAt(points, frame / this.fps), MAX_INTENSITY);
  }

  /** Mean of the applied intensity over speech, as `deitalk animate` prints it; undefined without speech. */
  get meanIntensity(): number | undefined {
    let sum = 0, count = 0;
    this.speaking?.forEach((speaks, k) => {
      if (!speaks) return;
      sum += this.intensityAt(k);
      count++;
    });
    return count ? sum / count : undefined;
  }

  /** The strongest emotion of a frame; undefined if it is unknown. */
  emotionAt(frame: number): string | undefined {
    const n = this.emotions.length, row = this.emotion?.subarray(frame * n, frame * n + n);
    return row && this.emotions[row.indexOf(Math.max(...row))];
  }

  /** All controls at a time, linear between frames. */
  at(seconds: number): Float32Array {
    return this.between(seconds, (frame) => this.frame(frame));
  }

  /** Turn and shift of the head at a time: degrees and cm. */
  headAt(seconds: number): Float32Array | undefined {
    const { head } = this.isExact ? this.exact!.take : this;
    const { fps, edit } = this;
    return head && this.between(seconds, (frame) => headWithLayers(head.slice(6 * frame, 6 * frame + 6), frame / fps, edit.layers ?? []));
  }

  private between(seconds: number, row: (frame: number) => Float32Array): Float32Array {
    const place = Math.min(Math.max(seconds * this.fps, 0), this.frames - 1);
    const low = Math.floor(place), high = Math.min(low + 1, this.frames - 1);
    const a = row(low), t = place - low;
    if (!t) return a;
    const b = row(high);
    return a.map((x, k) => x + t * (b[k] - x));
  }

  /** All controls of one frame with the edit, within their ranges; with other layers where they are given. */
  frame(index: number, layers: readonly Layer[] = this.edit.layers ?? []): Float32Array {
    const { board } = this, n = board.controls.length;
    const values = (this.isExact ? this.exact!.take : this).values;
    const out = values.slice(index * n, index * n + n);
    if (this.isBlend && this.neutral && this.intensity) {
      const share = this.intensityAt(index) / (this.intensity[index] || 1);
      for (let k = 0; k < n; k++) {
        const base = this.neutral[index * n + k];
        out[k] = base + (out[k] - base) * share;
      }
    }
    for (let k = 0; k < n; k++) {
      const scaled = board.rest[k] + (out[k] - board.rest[k]) * this.gains[k];
      out[k] = Math.min(Math.max(scaled, board.minimum[k]), board.maximum[k]);
    }
    return withLayers(out, index / this.fps, layers, board, this.edit.acting?.rules !== "false");
  }

  /** A fixed copy as it is now, under another name. */
  frozen(title: string): Take {
    const n = this.board.controls.length, values = new Float32Array(this.values.length);
    for (let k = 0; k < this.frames; k++) values.set(this.frame(k), k * n);
    const { fps, frames, emotions, audioSeconds } = this, arrays = this.head ? { values, head: this.head } : { values };
    return new Take({ facts: { title, fps, frames, emotions, audioSeconds }, arrays: arrays as Packed["arrays"] }, this.board, true);
  }

  /** The applied intensity of every frame, as `deitalk animate --intensity-curve` reads it. */
  intensityCsv(points = this.edit.points): string {
    const rows = Array.from({ length: this.frames }, (_, k) =>
      `${(k / this.fps).toFixed(6)},${Number(this.intensityAt(k, points).toPrecision(7))}`);
    return `time,intensity\n${rows.join("\n")}\n`;
  }
}
