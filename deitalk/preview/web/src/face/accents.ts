/** Depth of creases and shadow of lids, the same mathematics as `rig.face.accents` in Python. */

import type { Packed } from "../data/packed";
import type { Rig } from "./rig";

const clamp = (x: number) => Math.min(Math.max(x, 0), 1);
const smoothstep = (x: number) => clamp(x) ** 2 * (3 - 2 * clamp(x));

export class Accents {
  /** One number a vertex. */
  readonly values: Float32Array;

  constructor(private readonly head: Packed, private readonly rig: Rig) {
    this.values = new Float32Array(rig.vertices.length / 3);
  }

  /** Accents of control values, to which the rig is posed. */
  update(controls: ArrayLike<number>): void {
    const { facts, arrays } = this.head;
    const depth: number[] = facts.accents.least.slice();
    for (const [control, region, gain] of facts.accents.gains) depth[region] += gain * Math.max(controls[control], 0);
    const mask = arrays["accent.mask"];
    const [start, stop] = facts.slices.skin;
    for (let v = start; v < stop; v++) {
      let sum = 0;
      for (let r = 0; r < depth.length; r++) sum += clamp(depth[r]) * mask[r * (stop - start) + v - start];
      this.values[v] = Math.min(sum / 255, 1);
    }
    this.underLid("L");
    this.underLid("R");
  }

  private underLid(side: "L" | "R"): void {
    const { facts, arrays } = this.head;
    const { vertices } = this.rig;
    const [ex, ey, ez] = facts.eye, cx = side === "L" ? ex : -ex;
    const rim = arrays[`accent.rim.${side}`];
    const x = Array.from(rim, (v) => vertices[3 * v] - cx);
    const high = Array.from(rim, (v) => Math.atan2(vertices[3 * v + 1] - ey, vertices[3 * v + 2] - ez));
    const [start, stop] = facts.slices[`eye_${side}`];
    for (let v = start; v < stop; v++) {
      const px = vertices[3 * v] - cx, py = vertices[3 * v + 1] - ey, pz = vertices[3 * v + 2] - ez;
      let k = 1;
      while (k < x.length - 1 && px > x[k]) k++;
      const edge = high[k - 1] + clamp((px - x[k - 1]) / (x[k] - x[k - 1])) * (high[k] - high[k - 1]);
      const below = (edge - Math.atan2(py, pz)) / facts.accents.shadowRadians;
      this.values[v] = pz > 0 ? facts.accents.shadow * smoothstep(1 - below) : 0;
    }
  }
}
