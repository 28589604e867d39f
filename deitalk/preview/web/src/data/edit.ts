/** Edits of a performance, with undo: factor on the intensity, keys of emotion, gains of regions, layers. */

import type { Layer } from "./layers";

export interface FactorPoint {
  time: number;
  factor: number;
}

/** As `deitalk.emotions` reads keys: linear between them, the rest of the strength is neutral. */
export interface EmotionKey {
  time: number;
  emotion: string;
  strength: number;
}

/** Never changed in place: a change makes a new one. */
export interface Edit {
  readonly points: readonly FactorPoint[];
  readonly keys: readonly EmotionKey[];
  /** Factor of a region's distance from rest; 1 where none is given. */
  readonly gains: Readonly<Record<string, number>>;
  readonly muted: readonly string[];
  /** Edits of controls, in the order in which they apply. */
  readonly layers: readonly Layer[];
  /** Factors on the idle motion of brows, head, blinks and gaze; 1 where none is given. */
  readonly life: Readonly<Record<string, number>>;
  /** What is said, and the language in which it is pronounced; no words where it is empty. */
  readonly words: string;
  readonly language: string;
  /** Other fields of the acting, as text or as a file; those that are not given have their defaults. */
  readonly acting: Readonly<Record<string, string | File>>;
}

export const NO_EDIT: Edit = { points: [], keys: [], gains: {}, muted: [], layers: [], life: {}, words: "", language: "en-us", acting: {} };
export const MAX_FACTOR = 4;
export const MAX_GAIN = 2;

/** Factor at a time: linear between points, held outside; 1 without points. */
export function factorAt(points: readonly FactorPoint[], time: number): number {
  if (!points.length) return 1;
  const after = points.findIndex((point) => point.time >= time);
  if (after === 0) return points[0].factor;
  if (after < 0) return points[points.length - 1].factor;
  const a = points[after - 1], b = points[after];
  return a.factor + ((time - a.time) / (b.time - a.time)) * (b.factor - a.factor);
}

/** Gain of each region that is not left as it is; a muted one has 0. */
export function gainsOf(edit: Edit): Record<string, number> {
  const muted = Object.fromEntries(edit.muted.map((region) => [region, 0]));
  return Object.fromEntries(Object.entries({ ...edit.gains, ...muted }).filter(([, gain]) => gain !== 1));
}

export class History {
  private past: Edit[] = [];
  private future: Edit[] = [];
  private gesture = "";

  constructor(private now: Edit, private readonly changed: () => void) {}

  get edit(): Edit {
    return this.now;
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** Change a part; changes of one gesture, such as a drag, are undone together. */
  change(part: Partial<Edit>, gesture = ""): void {
    if (!gesture || gesture !== this.gesture) this.past.push(this.now);
    this.gesture = gesture;
    this.future = [];
    this.now = { ...this.now, ...part };
    this.changed();
  }

  /** Go on with a gesture under another name. */
  renameGesture(gesture: string): void {
    this.gesture = gesture;
  }

  endGesture(): void {
    this.gesture = "";
  }

  undo(): void {
    this.step(this.past, this.future);
  }

  redo(): void {
    this.step(this.future, this.past);
  }

  /** Begin anew, with nothing to undo. */
  reset(edit: Edit): void {
    this.past = [];
    this.future = [];
    this.endGesture();
    this.now = edit;
    this.changed();
  }

  private step(from: Edit[], to: Edit[]): void {
    const next = from.pop();
    if (!next) return;
    to.push(this.now);
    this.now = next;
    this.endGesture();
    this.changed();
  }
}
