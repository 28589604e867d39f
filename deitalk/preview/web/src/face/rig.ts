/** The head's rig, the same mathematics as `rig.face.head.Head.pose` in Python. */

import type { Arrays, Packed } from "../data/packed";

type Inputs = Record<string, number>;
type Vec = [number, number, number];

const clamp = (x: number, low = 0, high = 1) => Math.min(Math.max(x, low), high);
const smoothstep = (x: number) => {
  const t = clamp(x);
  return t * t * (3 - 2 * t);
};

function interpolate(x: number, at: number[], values: number[]): number {
  if (x <= at[0]) return values[0];
  for (let k = 1; k < at.length; k++) {
    if (x <= at[k]) {
      const t = (x - at[k - 1]) / (at[k] - at[k - 1]);
      return values[k - 1] + t * (values[k] - values[k - 1]);
    }
  }
  return values[values.length - 1];
}

export class Rig {
  readonly neutral: Float32Array;
  readonly vertices: Float32Array;
  readonly controls: string[];
  private readonly a: Arrays;
  private readonly f: Record<string, any>;
  private readonly place: Map<string, number>;

  constructor({ arrays, facts }: Packed) {
    this.a = arrays;
    this.f = facts;
    this.controls = facts.controls;
    this.place = new Map(this.controls.map((name, k) => [name, k]));
    this.neutral = arrays.vertices as Float32Array;
    this.vertices = this.neutral.slice();
  }

  /** Vertices (V * 3) for 185 control values; the array is reused by the next call. */
  pose(values: ArrayLike<number>): Float32Array {
    const inputs = this.inputs(values);
    this.vertices.set(this.neutral);
    this.addShapes(inputs);
    this.openJaw(inputs);
    this.clearTeeth(inputs);
    const turns = { L: this.turnLids(inputs, "L"), R: this.turnLids(inputs, "R") };
    this.seal(inputs);
    this.poseTeeth(inputs);
    this.poseTongue(inputs);
    this.poseEyes(inputs, turns);
    this.poseRest(inputs);
    return this.vertices;
  }

  private inputs(values: ArrayLike<number>): Inputs {
    const { a, f } = this;
    const total = new Float64Array(f.inputs.length);
    const count = this.controls.length;
    const control = a["bind.control"];
    for (let k = 0; k < control.length; k++) {
      const c = control[k];
      const value = c < count ? Math.max(values[c], 0) : Math.max(-values[c - count], 0);
      total[a["bind.input"][k]] += value * a["bind.gain"][k];
    }
    const inputs: Inputs = {};
    f.inputs.forEach((name: string, k: number) => (inputs[name] = total[k]));
    for (const s of ["L", "R"]) {
      const scale = values[this.place.get(`CTRL_${s}_nose_wrinkleUpper.ty`)!];
      inputs[`noseWrinkleUpper_${s}`] = inputs[`wrinkle_${s}`] * scale;
    }
    inputs.larynxUp += interpolate(inputs.swallow, [0, 0.2, 0.4, 0.6, 0.8, 1], [0, 0.4, 1, 1, 0.4, 0]);
    return inputs;
  }

  private addShapes(inputs: Inputs): void {
    const { a, f, vertices } = this;
    const start = a["shape.start"], index = a["shape.vertex"], delta = a["shape.delta"];
    f.shapes.forEach((name: string, k: number) => {
      const weight = (inputs[name] ?? 0) * a["shape.scale"][k];
      if (!weight) return;
      for (let e = start[k]; e < start[k + 1]; e++) {
        const v = 3 * index[e];
        vertices[v] += weight * delta[3 * e];
        vertices[v + 1] += weight * delta[3 * e + 1];
        vertices[v + 2] += weight * delta[3 * e + 2];
      }
    });
  }

  private jawMotion(inputs: Inputs): { angle: number; slide: Vec } {
    const open = clamp(inputs["jaw.open"], 0, 1.35);
    const [slideOpen, side, forward] = this.f.slide;
    return {
      angle: (this.f.openDegrees * open * Math.PI) / 180,
      slide: [side * inputs["jaw.left"], 0, forward * inputs["jaw.forward"] + slideOpen * open],
    };
  }

  private ride(p: Vec, angle: number, slide: Vec, share = 1): Vec {
    const [hx, hy, hz] = this.f.hinge;
    const y = p[1] - hy, z = p[2] - hz;
    const c = Math.cos(angle * share), s = Math.sin(angle * share);
    return [
      p[0] - hx + hx + slide[0] * share,
      c * y - s * z + hy + slide[1] * share,
      s * y + c * z + hz + slide[2] * share,
    ];
  }

  private unride(p: Vec, angle: number, slide: Vec): Vec {
    return this.ride([p[0] - slide[0], p[1] - slide[1], p[2] - slide[2]], -angle, [0, 0, 0]);
  }

  private get(k: number): Vec {
    return [this.vertices[3 * k], this.vertices[3 * k + 1], this.vertices[3 * k + 2]];
  }

  private put(k: number, p: Vec): void {
    this.vertices[3 * k] = p[0];
    this.vertices[3 * k + 1] = p[1];
    this.vertices[3 * k + 2] = p[2];
  }

  private openJaw(inputs: Inputs): void {
    const weight = this.a["jaw.weight"];
    const { angle, slide } = this.jawMotion(inputs);
    if (!angle && !slide[0] && !slide[2]) return;
    for (let k = 0; k < weight.length; k++) {
      if (weight[k] > 1e-4) this.put(k, this.ride(this.get(k), angle, slide, weight[k]));
    }
  }

  private teethShift(inputs: Inputs, jaw: string): Vec {
    return ["x", "y", "z"].map((axis) => 0.25 * inputs[`teeth.${jaw}_${axis}`]) as Vec;
  }

  private archPush(name: string, k: number, p: Vec, up: number): Vec {
    const { a, f } = this;
    const center = f.archCenter[name];
    const z = p[2] - center;
    if (z <= 0) return [0, 0, 0];
    const ratio = Math.sqrt(
      (p[0] / a[`arch.${name}.a`][k]) ** 2 + (z / a[`arch.${name}.b`][k]) ** 2 + 1e-9,
    );
    const beyond = up * (p[1] - f.archEdge[name]);
    const grow =
      Math.max(a[`arch.${name}.least`][k] / ratio - 1, 0) * smoothstep((beyond + 0.4) / 0.4);
    return [p[0] * grow, 0, z * grow];
  }

  private clearTeeth(inputs: Inputs): void {
    const { a } = this;
    const up = this.teethShift(inputs, "upper"), low = this.teethShift(inputs, "lower");
    const { angle, slide } = this.jawMotion(inputs);
    a["arch.upper.ids"].forEach((id, k) => {
      const p = this.get(id);
      const push = this.archPush("upper", k, [p[0] - up[0], p[1] - up[1], p[2] - up[2]], 1);
      this.put(id, [p[0] + push[0], p[1], p[2] + push[2]]);
    });
    a["arch.lower.ids"].forEach((id, k) => {
      const p = this.get(id);
      const q = this.unride(p, angle, slide);
      const push = this.archPush("lower", k, [q[0] - low[0], q[1] - low[1], q[2] - low[2]], -1);
      if (!push[0] && !push[2]) return;
      this.put(id, this.ride([q[0] + push[0], q[1], q[2] + push[2]], angle, slide));
    });
  }

  private turnLids(inputs: Inputs, name: "L" | "R"): Float64Array {
    const { a, f } = this;
    const ids = a[`lid.${name}.ids`], slot = a[`lid.${name}.slot`], share = a[`lid.${name}.share`];
    const rim = a[`lid.${name}.rim`], upper = a[`lid.${name}.upper`], arch = a[`lid.${name}.arch`];
    const [ex, ey, ez] = f.eye;
    const center: Vec = [name === "L" ? ex : -ex, ey, ez];
    const n = rim.length;
    const angle = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      const p = this.get(rim[k]);
      angle[k] = Math.atan2(p[1] - center[1], p[2] - center[2]);
    }
    const turn = this.rimTurns(inputs, name, angle, upper, arch);
    ids.forEach((id, k) => {
      const p = this.get(id);
      const by = turn[slot[k]] * share[k];
      const c = Math.cos(by), s = Math.sin(by);
      const x = p[0] - center[0], y = p[1] - center[1], z = p[2] - center[2];
      const q: Vec = [x, c * y + s * z, c * z - s * y];
      const grow = Math.max(f.lidLeast / Math.hypot(...q), 1);
      this.put(id, [center[0] + q[0] * grow, center[1] + q[1] * grow, center[2] + q[2] * grow]);
    });
    return turn;
  }

  private rimTurns(
    inputs: Inputs,
    name: string,
    angle: Float64Array,
    upper: ArrayLike<number>,
    arch: ArrayLike<number>,
  ): Float64Array {
    const meet = this.f.lidMeet as number;
    const get = (k: string) => inputs[`lid.${k}_${name}`];
    const unit = (k: string) => clamp(get(k));
    const blink = unit("close"), open = 1 - blink;
    const closeAll = blink + open * (0.85 * unit("upper") + 0.6 * unit("lookDown"));
    const raise = open * unit("lower") * 0.8 + blink * meet;
    const widen = Math.min(
      (0.24 * unit("widen") + 0.2 * unit("upperUp") + 0.28 * unit("lookUp")) * open,
      0.36,
    );
    const dip = Math.min(0.06 * unit("widen") + 0.16 * unit("lowerDown"), 0.26);
    const ride = 0.3 * unit("lookDown") - 0.1 * unit("lookUp") * open;
    const n = angle.length;
    const turn = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      if (arch[k] <= 1e-6) continue;
      const opposite = angle[(n - k) % n];
      const gap = Math.max(upper[k] > 0 ? angle[k] - opposite : opposite - angle[k], 0);
      const inner = 0.5 - 0.5 * Math.cos((k / n) * 2 * Math.PI);
      const close = closeAll + 0.3 * unit("frown") * inner;
      const room = 1 - (1 - meet) * clamp(close);
      const low = Math.min(clamp(Math.max(raise, close >= 1 ? meet : 0)), room) * gap;
      turn[k] =
        upper[k] > 0
          ? -(1 - meet) * clamp(close) * gap + (widen - ride) * arch[k]
          : low - (dip * (1 - clamp(close)) + ride) * arch[k];
    }
    return turn;
  }

  private sealAmount(inputs: Inputs, lip: "Upper" | "Lower", k: number): number {
    const u = this.a["seal.u"][k], left = this.a["seal.left"][k];
    const far = Math.abs(u);
    const inner = Math.exp(-(((far - 0.45) / 0.28) ** 2));
    const outer = smoothstep((far - 0.55) / 0.3);
    let amount = inputs[`seal.center${lip}`] * Math.exp(-((far / 0.35) ** 2));
    for (const [s, side] of [["L", left], ["R", 1 - left]] as const) {
      amount +=
        side *
        (inputs[`seal.${lip.toLowerCase()}_${s}`] +
          inputs[`seal.inner${lip}_${s}`] * inner +
          inputs[`seal.outer${lip}_${s}`] * outer +
          smoothstep((inputs[`seal.zip_${s}`] * 1.25 - 1 + far) / 0.25));
    }
    return clamp(amount);
  }

  private seal(inputs: Inputs): void {
    const { a, f } = this;
    const upper = a["seal.upper"], lower = a["seal.lower"], share = a["seal.share"];
    const n = a["seal.u"].length;
    for (let k = 0; k < n; k++) {
      const high = this.get(upper[f.sealRim * n + k]), low = this.get(lower[f.sealRim * n + k]);
      const gap = [low[0] - high[0], low[1] - high[1], low[2] - high[2]];
      const partUp = 0.38 * this.sealAmount(inputs, "Upper", k);
      const partLow = 0.62 * this.sealAmount(inputs, "Lower", k);
      const crossed = 0.5 * Math.max(gap[1], 0) * (1 - partUp - partLow);
      for (let r = 0; r < share.length; r++) {
        const i = 3 * upper[r * n + k], j = 3 * lower[r * n + k];
        for (let axis = 0; axis < 3; axis++) {
          const extra = axis === 1 ? crossed : 0;
          this.vertices[i + axis] += (gap[axis] * partUp + extra) * share[r];
          this.vertices[j + axis] -= (gap[axis] * partLow + extra) * share[r];
        }
      }
    }
  }

  private poseTeeth(inputs: Inputs): void {
    const up = this.teethShift(inputs, "upper"), low = this.teethShift(inputs, "lower");
    const { angle, slide } = this.jawMotion(inputs);
    const [u0, u1] = this.f.slices.teeth_upper;
    for (let k = u0; k < u1; k++) {
      const p = this.get(k);
      this.put(k, [p[0] + up[0], p[1] + up[1], p[2] + up[2]]);
    }
    const [l0, l1] = this.f.slices.teeth_lower;
    for (let k = l0; k < l1; k++) {
      const p = this.get(k);
      this.put(k, this.ride([p[0] + low[0], p[1] + low[1], p[2] + low[2]], angle, slide));
    }
  }

  private bentTongue(inputs: Inputs, k: number): Vec {
    const { a } = this;
    const get = (name: string) => inputs[`tongue.${name}`];
    const s = a["tongue.place"][k];
    const axis = [0, 1, 2].map((i) => a["tongue.axis"][3 * k + i]);
    const offset = [0, 1, 2].map((i) => a["tongue.rest"][3 * k + i] - axis[i]);
    const front = clamp(1 - s), tip = clamp(1 - s / 0.5) ** 1.5;
    const body = Math.sin(Math.PI * clamp(0.12 + 0.8 * s));
    const x0 = offset[0] * (1 + 0.26 * get("wide") * (1 - 0.5 * s));
    const y0 = offset[1] * (1 + 0.35 * get("thick") - 0.12 * get("wide"));
    const turn = ((28 * Math.PI) / 180) * get("twist") * front;
    const dx = x0 * Math.cos(turn) - y0 * Math.sin(turn);
    const dy = x0 * Math.sin(turn) + y0 * Math.cos(turn);
    const lift =
      0.95 * get("up") * body + 0.8 * get("press") * body + 1.35 * get("tipUp") * tip +
      0.75 * get("bend") * (tip - 0.35 * body) + 0.6 * get("out") * front ** 0.6;
    const sunk = clamp(inputs["jaw.open"]) * clamp(1 - get("out") - get("tipUp"));
    const sink = this.f.tongueSink * sunk * front ** 0.5;
    const reach =
      2.5 * get("out") * front ** 0.9 - 1.3 * get("in") * front -
      0.22 * get("tipUp") * tip - 0.3 * get("bend") * tip;
    return [
      axis[0] + dx + 0.85 * get("left") * front ** 0.8 + 0.75 * get("tipLeft") * tip,
      axis[1] + dy + lift - sink + 0.42 * get("roll") * a["tongue.across"][k] ** 2 * front,
      axis[2] + offset[2] + reach,
    ];
  }

  private poseTongue(inputs: Inputs): void {
    const { a, f } = this;
    const { angle, slide } = this.jawMotion(inputs);
    const shift = this.teethShift(inputs, "lower");
    const edge = this.ride(
      [shift[0], f.mouthY + f.teeth.lowerEdge + shift[1], f.lipZ - f.teeth.lowerBack + shift[2]],
      angle, slide,
    );
    const high = this.get(f.rimMiddle[0]), low = this.get(f.rimMiddle[1]);
    const upperEdge = f.mouthY + f.teeth.upperEdge, teethZ = f.lipZ - f.teeth.upperBack;
    const behindZ = f.lipZ - f.teeth.lowerBack - 0.29;
    const shut = upperEdge - edge[1] < 0.16;
    const start = f.slices.tongue[0];
    for (let k = 0; k < a["tongue.place"].length; k++) {
      const p = this.ride(this.bentTongue(inputs, k), angle, slide, a["tongue.jaw"][k]);
      if (shut) p[2] = Math.min(p[2], behindZ);
      const behind = Math.max(teethZ - 0.3 - p[2], 0);
      const vault = interpolate(behind, [0, 0.12, 0.5, 1.6, 3.5, 5.5], [0, 0.32, 0.85, 1.35, 1.4, 1.1]);
      let ceiling = upperEdge - 0.02 + vault * clamp(1 - 0.18 * p[0] ** 2, 0.3, 1);
      const past = smoothstep((p[2] - behindZ) / 0.2);
      let floor = edge[1] + 0.02 - 3 * (1 - past);
      floor += Math.max(low[1] + 0.02 - floor, 0) * smoothstep((p[2] - (low[2] - 0.75)) / 0.5);
      ceiling -= Math.max(ceiling - high[1] + 0.02, 0) * smoothstep((p[2] - (high[2] - 0.6)) / 0.4);
      let y = Math.min(p[1], ceiling);
      if (floor < ceiling) y = Math.max(y, floor);
      else if (past > 0.5) y = ceiling;
      this.put(start + k, [p[0], y, p[2]]);
    }
  }

  private poseEyes(inputs: Inputs, turns: Record<"L" | "R", Float64Array>): void {
    const { a, f } = this;
    const look = (axis: string, s: string) => clamp(inputs[`gaze.${axis}_${s}`], -1, 1);
    const parallel = clamp(inputs["gaze.parallel"]);
    for (const s of ["L", "R"] as const) {
      const side = s === "L" ? 1 : -1;
      const gaze = (axis: string) => {
        const own = look(axis, s);
        return own + parallel * (0.5 * (look(axis, "L") + look(axis, "R")) - own);
      };
      const y = gaze("y");
      const pitch = ((y > 0 ? f.gaze[1] : f.gaze[2]) * y * Math.PI) / 180;
      const yaw = ((f.gaze[0] * gaze("x") - side * f.convergence * (1 - parallel)) * Math.PI) / 180;
      const cp = Math.cos(pitch), sp = Math.sin(pitch), cw = Math.cos(yaw), sw = Math.sin(yaw);
      const start = f.slices[`eye_${s}`][0];
      const rest = a["eye.rest"], pupil = a["eye.pupil"];
      for (let k = 0; k < rest.length / 3; k++) {
        const b = [0, 1, 2].map((i) => rest[3 * k + i] + inputs[`pupil_${s}`] * pupil[3 * k + i]);
        const scale = f.eyeRadius / Math.hypot(b[0], b[1], b[2]);
        const bx = b[0] * scale, by = cp * b[1] * scale + sp * b[2] * scale;
        const bz = -sp * b[1] * scale + cp * b[2] * scale;
        this.put(start + k, [cw * bx + sw * bz + side * f.eye[0], by + f.eye[1], -sw * bx + cw * bz + f.eye[2]]);
      }
      this.poseLashes(inputs, s, turns[s]);
    }
  }

  private poseLashes(inputs: Inputs, s: string, turn: Float64Array): void {
    const { a, f, neutral } = this;
    const root = a[`lash.${s}.root`], slot = a[`lash.${s}.slot`], along = a[`lash.${s}.along`];
    const start = f.slices[`lash_${s}`][0];
    for (let k = 0; k < root.length; k++) {
      const at = 3 * (start + k), from = 3 * root[k];
      const offset = [0, 1, 2].map((i) => neutral[at + i] - neutral[from + i]);
      const angle =
        0.8 * turn[slot[k]] +
        0.35 * inputs[`lash.in_${s}`] * clamp(1 - 2 * along[k]) +
        0.35 * inputs[`lash.out_${s}`] * clamp(2 * along[k] - 1);
      const c = Math.cos(angle), n = Math.sin(angle);
      const p = this.get(root[k]);
      this.put(start + k, [p[0] + offset[0], p[1] + c * offset[1] + n * offset[2], p[2] + c * offset[2] - n * offset[1]]);
    }
  }

  private poseRest(inputs: Inputs): void {
    const { a, f, vertices, neutral } = this;
    for (const s of ["L", "R"]) {
      const near = a[`brow.${s}.near`], weight = a[`brow.${s}.weight`];
      const [start, stop] = f.slices[`brow_${s}`];
      const each = near.length / (stop - start);
      for (let k = 0; k < near.length; k++) {
        const to = 3 * (start + Math.floor(k / each)), from = 3 * near[k];
        for (let i = 0; i < 3; i++) {
          vertices[to + i] += weight[k] * (vertices[from + i] - neutral[from + i]);
        }
      }
      const lift = inputs[`ear_${s}`], side = s === "L" ? 1 : -1;
      const [e0, e1] = f.slices[`ear_${s}`];
      for (let k = e0; lift && k < e1; k++) {
        const p = this.get(k);
        this.put(k, [p[0] + 0.06 * side * lift, p[1] + 0.32 * lift, p[2] - 0.05 * lift]);
      }
    }
  }
}
