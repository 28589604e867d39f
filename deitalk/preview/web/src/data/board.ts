/** The controls that a face has, as the page is given them. */

/** Names, ranges, rest values and regions of the controls, from the head's facts. */
export interface Board {
  controls: string[];
  minimum: number[];
  maximum: number[];
  rest: number[];
  regions: string[];
  /** Columns of the named sets of controls. */
  sets?: Record<string, number[]>;
  /** What closes and parts the lips, which layers keep: `rig.curves.layers.Closures`. */
  closures?: { seals: number[][]; opening: number[]; begin: number; full: number };
}
