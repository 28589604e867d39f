/** The emotion lane: a band of the emotions' colours, and keys over it where they can be edited. */

import schema from "../data/acting.json";
import type { EmotionKey, History } from "../data/edit";
import type { Take } from "../data/take";
import { PointLane, type PointOwner } from "./points";
import type { Span } from "./span";

export const COLORS: Record<string, string> = schema.properties.emotion["x-colors"];
export const MOODS: string[] = schema.properties.emotion["x-procedural"];
const LEVEL_STEP = 0.05;

export class EmotionLane implements PointOwner {
  private readonly lane: PointLane;
  private take?: Take;
  /** Called when another key has the focus, or none. */
  onSelect: () => void = () => {};

  constructor(
    private readonly band: HTMLCanvasElement,
    box: SVGSVGElement,
    private readonly span: Span,
    private readonly history: History,
  ) {
    this.lane = new PointLane(box, span, this);
  }

  /** Keys are shown where a service can animate again. */
  set isEditable(on: boolean) {
    this.lane.isEditable = on;
  }

  get isEditable(): boolean {
    return this.lane.isEditable;
  }

  show(take: Take): void {
    this.take = take;
    this.layout();
  }

  points() {
    return this.keys.map(({ time, emotion, strength }) => ({
      time, level: strength, color: COLORS[emotion],
      label: `${emotion} ${Math.round(100 * strength)} % at ${time.toFixed(2)} s`,
    }));
  }

  steps(): [number, number] {
    return [1 / (this.take?.fps ?? 30), LEVEL_STEP];
  }

  move(index: number, time: number, level: number): void {
    const moved = { ...this.keys[index], time, strength: Math.round(100 * level) / 100 };
    this.history.change({ keys: this.keys.map((old, k) => (k === index ? moved : old)) }, `key ${index}`);
  }

  add(time: number, strength = 1, emotion = this.emotionAt(time)): number {
    const others = this.keys.filter((key) => Math.abs(key.time - time) > 1e-3);
    const keys = [...others, { time, emotion, strength: Math.round(100 * strength) / 100 }];
    keys.sort((a, b) => a.time - b.time);
    this.history.change({ keys });
    return keys.findIndex((key) => key.time === time);
  }

  /** Give an emotion to the key in focus, else to the only key, else to a key at a time. */
  choose(emotion: string, time: number): void {
    if (!this.keys.length) {
      this.add(0, 1, emotion);
      return;
    }
    const at = this.keys.length > 1 ? this.lane.selected : 0;
    if (at < 0) {
      this.lane.focus(this.add(time, 1, emotion));
      return;
    }
    const strength = this.keys[at].strength || 1;
    this.history.change({ keys: this.keys.map((key, k) => (k === at ? { ...key, emotion, strength } : key)) });
  }

  addAt(time: number): void {
    this.lane.focus(this.add(time));
  }

  remove(index: number): void {
    if (this.keys.length < 2) return;
    this.history.change({ keys: this.keys.filter((_, k) => k !== index) });
  }

  focused(): void {
    this.onSelect();
  }

  /** Emotion of the key in focus, else of the key before a time. */
  emotionAt(time: number): string {
    const key = this.keys[this.lane.selected] ?? [...this.keys].reverse().find((k) => k.time <= time) ?? this.keys[0];
    return key?.emotion ?? "neutral";
  }

  done(): void {
    this.history.endGesture();
  }

  layout(): void {
    this.lane.layout();
    const { take, band, span } = this;
    if (!take) return;
    const width = (band.width = band.clientWidth), n = take.emotions.length;
    const pen = band.getContext("2d")!;
    for (let x = 0; take.emotion && x < width; x++) {
      const frame = Math.min(Math.round(span.time(x, width) * take.fps), take.frames - 1);
      take.emotions.forEach((name, k) => {
        pen.globalAlpha = take.emotion![frame * n + k];
        pen.fillStyle = COLORS[name];
        pen.fillRect(x, 0, 1, band.height);
      });
    }
  }

  private get keys(): readonly EmotionKey[] {
    return this.history.edit.keys;
  }
}
