/** Applies the numbers of the head (`rig.face.web_export`) to controls, as `Head.pose` in Python. */

import type { Arrays, Packed } from "../data/packed";

const clamp = (x: number, low = 0, high = 1) => Math.min(Math.max(x, low), high);
export const smoothstep = (x: number) => clamp(x) ** 2 * (3 - 2 * clamp(x));
const DEGREE = Math.PI / 180;

export class Rig {
  readonly neutral: Float32Array;
  readonly vertices: Float32Array;
  readonly controls: string[];
  /** Inputs of seal and creases, of the last pose. */
  readonly inputs: Float64Array;
  private readonly a: Arrays;
  private readonly f: Record<string, any>;
  private readonly place: Map<string, number>;
  private readonly halves: Float64Array;

  constructor({ arrays, facts }: Packed) {
    this.a = arrays;
    this.f = facts;
    this.controls = facts.controls;
    this.place = new Map(this.controls.map((name, k) => [name, k]));
    this.neutral = Float32Array.from(arrays.points, (x) => x / facts.grid);
    this.vertices = this.neutral.slice();
    this.halves = new Float64Array(2 * this.controls.length + 1).fill(1);
    this.inputs = new Float64Array(arrays.bind.length / this.halves.length);
  }

  /** Vertices (V * 3) for 185 control values; the array is reused by the next call. */
  pose(values: ArrayLike<number>): Float32Array {
    this.drive(values);
    this.vertices.set(this.neutral);
    this.addShapes();
    this.clearEyes();
    const [first, last] = this.f.seal.finish;
    const finished = (amount: number) => smoothstep((amount - first) / (last - first));
    for (const of of [(amount: number) => amount, finished, () => 0]) this.sealLips(of);
    this.follow();
    this.turnEyes(values);
    this.copySeams();
    return this.vertices;
  }

  /** Travel of each half of each control, and from it the inputs. */
  private drive(values: ArrayLike<number>): void {
    const { minimum, maximum, rest } = this.f;
    const count = this.controls.length, bind = this.a.bind, n = this.inputs.length;
    this.inputs.fill(0);
    for (let c = 0; c < count; c++) {
      const moved = values[c] - rest[c], up = maximum[c] - rest[c], down = rest[c] - minimum[c];
      this.halves[c] = up > 0 ? clamp(moved / up) : 0;
      this.halves[count + c] = down > 0 ? clamp(-moved / down) : 0;
      for (const half of [c, count + c]) {
        const travel = this.halves[half];
        for (let j = 0; travel && j < n; j++) this.inputs[j] += travel * bind[half * n + j];
      }
    }
  }

  private addShapes(): void {
    const { a, vertices, halves } = this;
    const start = a["shape.start"], index = a["shape.vertex"], delta = a["shape.delta"];
    const driver = a["shape.driver"], peak = a["shape.peak"], gain = a["shape.gain"];
    for (let k = 0; k < gain.length; k++) {
      const d = 4 * k;
      const product =
        Math.min(halves[driver[d]], halves[driver[d + 1]]) * Math.min(halves[driver[d + 2]], halves[driver[d + 3]]);
      const weight = (peak[k] ? 1 - Math.abs(2 * product - 1) : product) * gain[k];
      if (!weight) continue;
      for (let e = start[k]; e < start[k + 1]; e++) {
        const v = 3 * index[e];
        vertices[v] += weight * delta[3 * e];
        vertices[v + 1] += weight * delta[3 * e + 1];
        vertices[v + 2] += weight * delta[3 * e + 2];
      }
    }
  }

  private clearEyes(): void {
    this.f.eyes.forEach(([x, y, z]: number[], k: number) => {
      const least = this.a[`lid${k}.least`], v = this.vertices;
      this.a[`lid${k}.ids`].forEach((id: number, n: number) => {
        const i = 3 * id, dx = v[i] - x, dy = v[i + 1] - y, dz = v[i + 2] - z;
        const grow = Math.max(least[n] / Math.hypot(dx, dy, dz) - 1, 0);
        v[i] += dx * grow;
        v[i + 1] += dy * grow;
        v[i + 2] += dz * grow;
      });
    });
  }

  /** Means of a lip's rim at each column, in threes. */
  columns(lip: number): Float64Array {
    const rim = this.a[`lip${lip}.rim`], weight = this.a[`lip${lip}.weight`], count = rim.length;
    const out = new Float64Array((3 * weight.length) / count);
    for (let p = 0; p < out.length / 3; p++) {
      for (let n = 0; n < count; n++) {
        const share = weight[p * count + n], i = 3 * rim[n];
        if (!share) continue;
        for (let axis = 0; axis < 3; axis++) out[3 * p + axis] += share * this.vertices[i + axis];
      }
    }
    return out;
  }

  private sealLips(of: (amount: number) => number): void {
    const { fade, parts, count } = this.sealed(of);
    const upper = this.columns(0), lower = this.columns(1);
    const { along } = this.f.seal;
    [upper.slice(), lower.slice()].forEach((move, lip) => {
      for (let p = 0; p < count; p++) {
        const gap = upper[3 * p + 1] - lower[3 * p + 1];
        const crossed = 0.5 * Math.min(gap, 0) * (1 - parts[0][p] - parts[1][p]);
        for (let axis = 0; axis < 3; axis++) {
          const apart = upper[3 * p + axis] - lower[3 * p + axis];
          const by = (apart * parts[lip][p] + (axis === 1 ? crossed : 0)) * fade[p];
          move[3 * p + axis] = lip ? by : -by;
        }
      }
      const column = this.a[`lip${lip}.column`], share = this.a[`lip${lip}.share`];
      this.a[`lip${lip}.reach`].forEach((id: number, n: number) => {
        const low = Math.min(Math.floor(column[n]), count - 2), t = column[n] - low;
        for (let axis = 0; axis < 3; axis++) {
          const by = move[3 * low + axis] * (1 - t) + move[3 * low + 3 + axis] * t;
          this.vertices[3 * id + axis] += by * share[n] * along[axis];
        }
      });
    });
  }

  /** How far each lip covers the gap at each column, of how far it is sealed. */
  private sealed(of: (amount: number) => number) {
    const fade = this.a["seal.fade"], count = fade.length;
    const parts = [0, 1].map((lip) => {
      const profile = this.a[`lip${lip}.profile`];
      return Array.from({ length: count }, (_, p) => {
        let sum = 0;
        for (let j = 0; j < this.inputs.length; j++) sum += this.inputs[j] * profile[j * count + p];
        return of(clamp(sum)) * this.f.seal.parts[lip];
      });
    });
    return { fade, parts, count };
  }

  private follow(): void {
    const { a, vertices, neutral } = this;
    const near = a["follow.near"], weight = a["follow.weight"];
    const each = near.length / a["follow.vertex"].length;
    a["follow.vertex"].forEach((id: number, n: number) => {
      for (let k = n * each; k < (n + 1) * each; k++) {
        const from = 3 * near[k];
        for (let axis = 0; weight[k] && axis < 3; axis++) {
          vertices[3 * id + axis] += weight[k] * (vertices[from + axis] - neutral[from + axis]);
        }
      }
    });
  }

  private turnEyes(values: ArrayLike<number>): void {
    const { f, vertices } = this;
    const value = (name: string) => values[this.place.get(name)!];
    const look = (axis: string) => {
      const both = ["L", "R"].map((s) => clamp(value(`CTRL_${s}_eye.${axis}`) + value(`CTRL_C_eye.${axis}`), -1, 1));
      const mean = (both[0] + both[1]) / 2;
      return both.map((x) => x + parallel * (mean - x));
    };
    const parallel = clamp(value("CTRL_C_eye_parallelLook.ty"));
    const x = look("tx"), y = look("ty");
    f.eyes.forEach(([cx, cy, cz]: number[], k: number) => {
      const pitch = (y[k] > 0 ? f.gaze[1] : f.gaze[2]) * y[k] * DEGREE;
      const yaw = (f.gaze[0] * x[k] + (k ? 1 : -1) * f.convergence * (1 - parallel)) * DEGREE;
      const cp = Math.cos(pitch), sp = Math.sin(pitch), cw = Math.cos(yaw), sw = Math.sin(yaw);
      const [start, stop] = f.slices[k ? "eye_R" : "eye_L"];
      for (let i = 3 * start; i < 3 * stop; i += 3) {
        const bx = vertices[i] - cx, dy = vertices[i + 1] - cy, dz = vertices[i + 2] - cz;
        const by = cp * dy + sp * dz, bz = cp * dz - sp * dy;
        vertices[i] = cw * bx + sw * bz + cx;
        vertices[i + 1] = by + cy;
        vertices[i + 2] = cw * bz - sw * bx + cz;
      }
    });
  }

  private copySeams(): void {
    const [start, stop] = this.f.slices.seam, weld = this.a.weld;
    for (let v = start; v < stop; v++) {
      this.vertices.copyWithin(3 * v, 3 * weld[v], 3 * weld[v] + 3);
    }
  }
}
