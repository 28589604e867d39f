/** Depth of creases and shadow of lids and lips, the same mathematics as `rig.face.accents` in Python. */

import type { Packed } from "../data/packed";
import { type Rig, smoothstep } from "./rig";

const clamp = (x: number) => Math.min(Math.max(x, 0), 1);

/** Value at `at` of the line through places `x`, which rise, and values `y`. */
function between(x: number[], y: number[], at: number): number {
  let k = 1;
  while (k < x.length - 1 && at > x[k]) k++;
  return y[k - 1] + clamp((at - x[k - 1]) / (x[k] - x[k - 1])) * (y[k] - y[k - 1]);
}

export class Accents {
  /** One number a vertex. */
  readonly values: Float32Array;

  constructor(private readonly head: Packed, private readonly rig: Rig) {
    this.values = new Float32Array(rig.vertices.length / 3);
  }

  /** Accents of the controls to which the rig is posed. */
  update(): void {
    const { facts, arrays } = this.head;
    const { inputs, least } = facts.accents;
    const depth: number[] = least.map((x: number, r: number) => clamp(x + this.rig.inputs[inputs[r]]));
    const mask = arrays.creases, count = mask.length / depth.length;
    for (let v = 0; v < count; v++) {
      let sum = 0;
      for (let r = 0; r < depth.length; r++) sum += depth[r] * mask[r * count + v];
      this.values[v] = Math.min(sum / 255, 1);
    }
    if (arrays.mouth.length) this.inMouth();
    const [start, stop] = facts.slices.seam;
    for (let v = start; v < stop; v++) this.values[v] = this.values[arrays.weld[v]];
    this.underLid(0);
    this.underLid(1);
  }

  private inMouth(): void {
    const { facts, arrays } = this.head;
    const { teeth, mouthShadow, mouthLight, lips } = facts.accents;
    const [rise, clear, soft, begin, fade, beside] = mouthLight;
    const lip = this.rig.columns(0), x: number[] = [], y: number[] = [], z: number[] = [];
    let front = -Infinity;
    for (let i = 0; i < lip.length; i += 3) {
      x.push(lip[i]);
      y.push(lip[i + 1]);
      z.push(lip[i + 2]);
      front = Math.max(front, lip[i + 2]);
    }
    const { vertices } = this.rig;
    const rim = (v: number) => between(x, z, vertices[3 * v]);
    const shadow = (v: number) => {
      const depth = front + beside * (rim(v) - front) - vertices[3 * v + 2];
      const under = (clear - (between(x, y, vertices[3 * v]) - vertices[3 * v + 1] - rise * depth)) / soft;
      return mouthShadow * smoothstep(Math.max(under, (depth - begin) / fade));
    };
    for (let v = teeth[0]; v < teeth[1]; v++) this.values[v] = shadow(v);
    arrays.mouth.forEach((v: number) => {
      const behind = rim(v) - vertices[3 * v + 2];
      this.values[v] = -shadow(v) * smoothstep((behind - lips[0]) / lips[1]);
    });
  }

  private underLid(eye: number): void {
    const { facts, arrays } = this.head;
    const { vertices } = this.rig;
    const [cx, cy, cz] = facts.eyes[eye];
    const rim = arrays[`lid${eye}.rim`];
    if (!rim.length) return;
    const x = Array.from(rim, (v) => vertices[3 * v] - cx);
    const high = Array.from(rim, (v) => Math.atan2(vertices[3 * v + 1] - cy, vertices[3 * v + 2] - cz));
    const [start, stop] = facts.slices[eye ? "eye_R" : "eye_L"];
    const { shadow, shadowRadians, corner } = facts.accents;
    const middle = (x[0] + x[x.length - 1]) / 2, half = (x[x.length - 1] - x[0]) / 2;
    for (let v = start; v < stop; v++) {
      const px = vertices[3 * v] - cx, py = vertices[3 * v + 1] - cy, pz = vertices[3 * v + 2] - cz;
      const below = (between(x, high, px) - Math.atan2(py, pz)) / shadowRadians;
      const under = shadow * smoothstep(1 - below);
      const aside = corner[1] * smoothstep((Math.abs(px - middle) / half - corner[0]) / (1 - corner[0]));
      this.values[v] = pz > 0 ? under + (1 - under) * aside : 0;
    }
  }
}
