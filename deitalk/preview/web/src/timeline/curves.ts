/** Curve lanes: key controls and any the user adds, on one uPlot; other takes are dashed. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";

import type { Take } from "../data/take";
import type { Span } from "./span";

const HEIGHT = 170;
const KEY = [
  "CTRL_C_jaw.ty", "CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_mouth_funnelU.ty",
  "CTRL_L_mouth_cornerPull.ty", "CTRL_L_brow_down.ty", "CTRL_L_eye_blink.ty",
];
const STROKES = ["#f0aa5a", "#5ab88c", "#5a96e8", "#d8a81e", "#e2604f", "#a58be0", "#4bb3c4", "#d070a8"];

export class CurveLanes {
  private chart?: uPlot;
  private takes: Take[] = [];
  private names = [...KEY];
  private time = 0;
  private readonly head = document.createElement("div");

  constructor(
    private readonly box: HTMLElement,
    private readonly span: Span,
    private readonly controls: string[],
    private readonly seek: (seconds: number) => void,
  ) {
    this.head.className = "playhead";
  }

  show(takes: Take[]): void {
    this.takes = takes;
    this.build();
  }

  add(name: string): void {
    if (!this.names.includes(name)) this.names.push(name);
    this.build();
  }

  build(): void {
    const [first] = this.takes;
    if (!first) return;
    const times = Array.from({ length: first.frames }, (_, k) => k / first.fps);
    const data = this.takes.flatMap((take) => this.rows(take, times));
    const lowest = Math.min(0, ...data.map((row) => row.reduce((low: number, x) => Math.min(low, x ?? 0), 0)));
    this.chart?.destroy();
    this.chart = new uPlot(this.options(lowest), [times, ...data], this.box);
    this.chart.over.append(this.head);
    this.at(this.time);
  }

  at(time: number): void {
    this.time = time;
    const x = this.chart?.valToPos(time, "x");
    if (x === undefined) return;
    this.head.hidden = x < 0 || x > this.box.clientWidth;
    this.head.style.transform = `translateX(${x}px)`;
  }

  /** Follow the width of the box and the span. */
  resize(): void {
    const { chart, span } = this;
    if (!chart) return;
    chart.setSize({ width: this.box.clientWidth, height: HEIGHT });
    chart.setScale("x", { min: span.start, max: span.end });
    this.at(this.time);
  }

  private rows(take: Take, times: number[]): (number | null)[][] {
    const frames = times.map((time) => (time < take.seconds ? take.at(time) : undefined));
    return this.names.map((name) => {
      const c = this.controls.indexOf(name);
      return frames.map((values) => values?.[c] ?? null);
    });
  }

  private options(lowest: number): uPlot.Options {
    const { span } = this;
    const axis = { stroke: () => getComputedStyle(document.body).color, grid: { stroke: "#8883", width: 1 } };
    return {
      width: this.box.clientWidth || 300,
      height: HEIGHT,
      padding: [8, 0, 0, 0],
      cursor: { drag: { x: false, y: false } },
      scales: {
        x: { time: false, range: () => [span.start, span.end] },
        y: { range: [lowest - 0.03, 1.03] },
      },
      // keeps the lane as wide as the others; the first label would be cut off
      axes: [
        { ...axis, size: 26, values: (_u, times) => times.map((t) => (t > span.start ? String(t) : "")) },
        { ...axis, size: 0, ticks: { show: false }, values: () => [] },
      ],
      series: [{ label: "s" }, ...this.takes.flatMap((take, which) => this.names.map((name, k) => ({
        label: name.replace("CTRL_", "") + (which ? ` (${take.title})` : ""),
        stroke: STROKES[k % STROKES.length], width: 1.2, dash: which ? [5, 4] : undefined, points: { show: false },
      })))],
      legend: { live: false },
      hooks: {
        ready: [(u) => u.over.addEventListener("click", (e) => this.seek(u.posToVal(e.offsetX, "x")))],
      },
    };
  }
}
