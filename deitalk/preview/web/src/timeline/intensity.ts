/** The intensity lane: predicted and applied intensity, and the factor between them as points. */

import { type FactorPoint, factorAt, type History, MAX_FACTOR } from "../data/edit";
import type { Take } from "../data/take";
import { PointLane, type PointOwner, svg } from "./points";
import type { Span } from "./span";

/** Factors 0, 1 and 4 are at the bottom, the middle and the top. */
const levelOf = (factor: number) => Math.sqrt(factor / MAX_FACTOR);
const factorOf = (level: number) => Math.round(level * level * MAX_FACTOR * 100) / 100;
const LEVEL_STEP = 0.02;
const LEAST_TOP = 1.2;

export class IntensityLane implements PointOwner {
  private readonly lane: PointLane;
  private readonly area = svg("polygon", "area");
  private readonly predicted = svg("polyline", "predicted");
  private readonly one = svg("line", "one");
  private readonly line = svg("polyline", "factor");
  private readonly head = svg("line", "head");
  private take?: Take;

  constructor(box: SVGSVGElement, private readonly span: Span, private readonly history: History) {
    box.append(this.area, this.predicted, this.one, this.line, this.head);
    this.lane = new PointLane(box, span, this);
  }

  show(take: Take): void {
    this.take = take;
    this.lane.isEditable = take.isEditable;
    this.layout();
  }

  points() {
    return this.factors.map(({ time, factor }) => ({
      time, level: levelOf(factor), label: `factor ${factor.toFixed(2)} at ${time.toFixed(2)} s`,
    }));
  }

  steps(): [number, number] {
    return [1 / (this.take?.fps ?? 30), LEVEL_STEP];
  }

  move(index: number, time: number, level: number): void {
    const p = this.factors, gap = 1 / (this.take?.fps ?? 30);
    const low = index ? p[index - 1].time + gap : 0;
    const high = index < p.length - 1 ? p[index + 1].time - gap : this.take!.seconds;
    const moved = { time: Math.min(Math.max(time, low), high), factor: factorOf(level) };
    this.history.change({ points: p.map((old, k) => (k === index ? moved : old)) }, `point ${index}`);
  }

  add(time: number, level?: number): number {
    const factor = level === undefined ? factorAt(this.factors, time) : factorOf(level);
    const others = this.factors.filter((p) => Math.abs(p.time - time) > 1e-3);
    const points = [...others, { time, factor }].sort((a, b) => a.time - b.time);
    this.history.change({ points });
    return points.findIndex((p) => p.time === time);
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
  }

  layout(): void {
    const { take, lane } = this;
    if (!take) return;
    const height = lane.box.clientHeight, middle = String(lane.y(levelOf(1)));
    for (const [name, value] of [["x1", "0"], ["x2", String(lane.width)], ["y1", middle], ["y2", middle]]) {
      this.one.setAttribute(name, value);
    }
    this.line.setAttribute("points", this.factorLine());
    const frames = take.intensity ? this.frames() : [];
    const top = Math.max(LEAST_TOP, ...frames.map((f) => Math.max(take.intensityAt(f), take.intensity![f])));
    const draw = (value: (frame: number) => number) =>
      frames.map((f) => `${lane.x(f / take.fps)},${height * (1 - value(f) / top)}`).join(" ");
    this.predicted.setAttribute("points", draw((f) => take.intensity![f]));
    const [first, last] = [frames[0] ?? 0, frames[frames.length - 1] ?? 0].map((f) => lane.x(f / take.fps));
    this.area.setAttribute("points", `${first},${height} ${draw((f) => take.intensityAt(f))} ${last},${height}`);
    lane.layout();
  }

  at(time: number): void {
    const x = String(this.lane.x(time));
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", "0"], ["y2", String(this.lane.box.clientHeight)]]) {
      this.head.setAttribute(name, value);
    }
  }

  private get factors(): readonly FactorPoint[] {
    return this.history.edit.points;
  }

  /** The factor at every second pixel: its scale bends straight lines. */
  private factorLine(): string {
    const { lane, span } = this, width = lane.width;
    return Array.from({ length: Math.ceil(width / 2) + 1 }, (_, k) => {
      const factor = factorAt(this.factors, span.time(2 * k, width));
      return `${2 * k},${lane.y(levelOf(factor))}`;
    }).join(" ");
  }

  /** Frames of the span, at most one for each pixel. */
  private frames(): number[] {
    const { fps, frames } = this.take!, { start, end } = this.span;
    const first = Math.max(Math.floor(start * fps), 0), last = Math.min(Math.ceil(end * fps), frames - 1);
    const step = Math.max(1, Math.floor((last - first) / Math.max(this.lane.width, 1)));
    return Array.from({ length: Math.floor((last - first) / step) + 1 }, (_, k) => first + k * step);
  }
}
