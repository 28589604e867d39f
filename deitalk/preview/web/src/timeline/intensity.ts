/** The intensity lane: predicted and applied intensity on a linear axis; the line is dragged. */

import { type FactorPoint, factorAt, type History, MAX_FACTOR } from "../data/edit";
import type { Take } from "../data/take";
import { MARGIN, PointLane, type PointOwner, svg } from "./points";
import type { Span } from "./span";

const LEVEL_STEP = 0.02;
/** Labels of the axis, and the room that is left above the highest intensity, as a factor. */
const GRID = 0.5, ROOM = 1.3;
/** Predicted intensity below which a factor is reckoned as if it were this. */
const FAINT = 0.02;
/** How near the line a press takes it, pixels, and how far a drag bends it to either side, seconds. */
const NEAR = 14, REACH = 0.4;

export class IntensityLane implements PointOwner {
  private readonly lane: PointLane;
  private readonly axis = svg("g", "axis");
  private readonly area = svg("polygon", "area");
  private readonly predicted = svg("polyline", "predicted");
  private readonly applied = svg("polyline", "applied");
  private readonly head = svg("line", "head");
  private take?: Take;
  /** Intensity at the top; it stays during a drag. */
  private top = 1;

  constructor(box: SVGSVGElement, private readonly span: Span, private readonly history: History) {
    box.append(this.axis, this.area, this.predicted, this.applied, this.head);
    this.lane = new PointLane(box, span, this);
  }

  show(take: Take): void {
    this.take = take;
    this.lane.isEditable = take.isEditable;
    this.scale();
  }

  points() {
    return this.factors.map(({ time, factor }) => ({
      time, level: this.appliedAt(time) / this.top,
      label: `intensity ${this.appliedAt(time).toFixed(2)}, factor ${factor.toFixed(2)} at ${time.toFixed(2)} s`,
    }));
  }

  steps(): [number, number] {
    return [1 / (this.take?.fps ?? 30), LEVEL_STEP];
  }

  move(index: number, time: number, level: number): void {
    const moved = { time, factor: this.factorOf(time, level) };
    this.history.change({ points: this.factors.map((old, k) => (k === index ? moved : old)) }, `point ${index}`);
  }

  add(time: number, level?: number): number {
    const factor = level === undefined ? factorAt(this.factors, time) : this.factorOf(time, level);
    return this.insert([{ time, factor }], time);
  }

  /** Take the line near a press: a point there, and one to either side that holds the rest. */
  grab(time: number, level: number): number | undefined {
    const pixels = Math.abs(level - this.appliedAt(time) / this.top) * (this.lane.box.clientHeight - 2 * MARGIN);
    if (pixels > NEAR) return undefined;
    const isFree = (t: number) => t >= 0 && t <= this.take!.seconds && !this.factors.some((p) => Math.abs(p.time - t) < REACH);
    const times = [time, ...[time - REACH, time + REACH].filter(isFree)];
    return this.insert(times.map((t) => ({ time: t, factor: factorAt(this.factors, t) })), time, true);
  }

  /** Add a point on the line and give it the focus. */
  addAt(time: number): void {
    this.lane.focus(this.add(time));
  }

  remove(index: number): void {
    this.history.change({ points: this.factors.filter((_, k) => k !== index) });
  }

  done(): void {
    this.history.endGesture();
    this.scale();
  }

  layout(): void {
    const { take, lane, top } = this;
    if (!take) return;
    const frames = take.intensity ? this.frames() : [];
    const draw = (value: (frame: number) => number) =>
      frames.map((f) => `${lane.x(f / take.fps)},${lane.y(value(f) / top)}`).join(" ");
    const line = draw((f) => take.intensityAt(f));
    this.predicted.setAttribute("points", draw((f) => take.intensity![f]));
    this.applied.setAttribute("points", line);
    const [first, last] = [frames[0] ?? 0, frames[frames.length - 1] ?? 0].map((f) => lane.x(f / take.fps));
    this.area.setAttribute("points", `${first},${lane.y(0)} ${line} ${last},${lane.y(0)}`);
    this.drawAxis();
    lane.layout();
  }

  at(time: number): void {
    const x = String(this.lane.x(time));
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", "0"], ["y2", String(this.lane.box.clientHeight)]]) {
      this.head.setAttribute(name, value);
    }
  }

  /** Follow the highest intensity, but not in a drag. */
  scale(): void {
    const { take } = this, values = take?.intensity ? Array.from(take.intensity, (value, f) => Math.max(value, take.intensityAt(f))) : [];
    const highest = values.reduce((high, value) => Math.max(high, value), 0);
    if (!this.lane.isDragged) this.top = Math.max(1, Math.ceil((ROOM * highest) / GRID) * GRID);
    this.layout();
  }

  private drawAxis(): void {
    const { lane, top } = this;
    this.axis.replaceChildren(...Array.from({ length: Math.round(top / GRID) + 1 }, (_, k) => {
      const line = svg("line"), label = svg("text"), y = String(lane.y((k * GRID) / top));
      for (const [name, value] of [["x1", "0"], ["x2", String(lane.width)], ["y1", y], ["y2", y]]) line.setAttribute(name, value);
      label.setAttribute("x", "3");
      label.setAttribute("y", y);
      label.textContent = (k * GRID).toFixed(1);
      const mark = svg("g");
      mark.append(line, label);
      return mark;
    }));
  }

  private get factors(): readonly FactorPoint[] {
    return this.history.edit.points;
  }

  private frameAt(time: number): number {
    return Math.min(Math.max(Math.round(time * this.take!.fps), 0), this.take!.frames - 1);
  }

  /** Applied intensity at a time. */
  private appliedAt(time: number): number {
    return this.take!.intensityAt(this.frameAt(time), this.factors);
  }

  /** The factor that brings the prediction at a time to a level. */
  private factorOf(time: number, level: number): number {
    const predicted = Math.max(this.take!.intensity![this.frameAt(time)], FAINT);
    return Math.round(Math.min((level * this.top) / predicted, MAX_FACTOR) * 100) / 100;
  }

  /** Add points, at once or as the start of a drag; return the place of the one at a time. */
  private insert(added: FactorPoint[], time: number, isDrag = false): number {
    const others = this.factors.filter((p) => !added.some((q) => Math.abs(p.time - q.time) <= 1e-3));
    const points = [...others, ...added].sort((a, b) => a.time - b.time);
    const index = points.findIndex((p) => p.time === time);
    this.history.change({ points }, isDrag ? `point ${index}` : "");
    return index;
  }

  /** Frames of the span, at most one for each pixel. */
  private frames(): number[] {
    const { fps, frames } = this.take!, { start, end } = this.span;
    const first = Math.max(Math.floor(start * fps), 0), last = Math.min(Math.ceil(end * fps), frames - 1);
    const step = Math.max(1, Math.floor((last - first) / Math.max(this.lane.width, 1)));
    return Array.from({ length: Math.floor((last - first) / step) + 1 }, (_, k) => first + k * step);
  }
}
