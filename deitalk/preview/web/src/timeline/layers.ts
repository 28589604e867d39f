/** Layers of edits: a lane in which a control or a region is dragged, and the list of layers. */

import type { History } from "../data/edit";
import { columnsOf, curveAt, type Key, type Layer, type LayerEdit, layersText, SCHEMA, slopeAt, spanOf, withKeys } from "../data/layers";
import type { Board } from "../data/board";
import type { Take } from "../data/take";
import { $, button, notice, save } from "../dom";
import { MARGIN, PointLane, type PointOwner, svg } from "./points";
import type { Span } from "./span";

const LEVEL_STEP = 0.02;
/** How near the line a press takes it, pixels. */
const NEAR = 14;

/** A key in the lane: places of its edit in the layer, and of the key in the edit. */
interface Place {
  edit: number;
  key: number;
}

export class LayerLane implements PointOwner {
  private readonly lane: PointLane;
  private readonly before = svg("polyline", "predicted");
  private readonly after = svg("polyline", "applied");
  private readonly head = svg("line", "head");
  private readonly field = $<HTMLInputElement>("edit-target");
  /** How many frames a drag bends the curve to either side; 1: it moves one frame. */
  private readonly reach = $<HTMLInputElement>("edit-reach");
  private take?: Take;
  private target = "CTRL_C_jaw.ty";
  /** Index of the layer that is edited. */
  private active = 0;

  constructor(
    box: SVGSVGElement,
    private readonly span: Span,
    private readonly board: Board,
    private readonly history: History,
    /** Shows a control among the curves. */
    private readonly shown: (control: string) => void,
  ) {
    box.append(this.before, this.after, this.head);
    this.lane = new PointLane(box, span, this);
    const names = [...new Set(board.regions), ...board.controls];
    $("edit-targets").append(...names.map((value) => Object.assign(document.createElement("option"), { value })));
    this.field.value = this.target;
    this.field.addEventListener("change", () => this.choose(this.field.value.trim()));
    $("add-layer").addEventListener("click", () => this.addLayer());
    $("save-layers").addEventListener("click", () => {
      save(new Blob([layersText(this.layers)], { type: "application/json" }), "fixes.edit.json");
    });
  }

  /** Edit a control or a region from now on. */
  choose(target: string): void {
    if (!columnsOf(this.board, target).length) return notice(`${target}: no control or region has this name`);
    this.target = this.field.value = target;
    if (this.isControl) this.shown(target);
    this.layout();
  }

  show(take: Take): void {
    this.take = take;
    this.lane.isEditable = true;
    this.edited();
  }

  /** Add a key on the curve and give it the focus. */
  addAt(time: number): void {
    this.lane.focus(this.add(time));
  }

  /** Follow the layers of the edit. */
  edited(): void {
    this.active = Math.min(this.active, Math.max(this.layers.length - 1, 0));
    $<HTMLButtonElement>("save-layers").disabled = !this.layers.some((layer) => layer.edits.length);
    $("layers").replaceChildren(...this.layers.map((layer, k) => this.row(layer, k)));
    this.layout();
  }

  points() {
    return this.places.map(({ edit, key }) => {
      const [time, value] = this.edits[edit].keys[key];
      return { time, level: this.levelOf(this.shownAt(time)), label: `${this.target} ${value >= 0 ? "+" : ""}${value.toFixed(2)} at ${time.toFixed(2)} s` };
    });
  }

  steps(): [number, number] {
    return [1 / (this.take?.fps ?? 30), LEVEL_STEP];
  }

  move(index: number, time: number, level: number): void {
    const { edit, key } = this.places[index], old = this.edits[edit], { fps } = this.take!;
    const at = Math.round(time * fps) / fps, moved = [at, this.offsetOf(at, level), ...old.keys[key].slice(2)];
    this.put(edit, old.keys.map((other, k) => (k === key ? moved : other)), `layer ${this.target} ${index}`);
  }

  add(time: number, level?: number): number {
    return this.insert(time, level === undefined ? this.offsetAt(time) : this.offsetOf(time, level));
  }

  grab(time: number, level: number): number | undefined {
    const pixels = Math.abs(level - this.levelOf(this.shownAt(time))) * (this.lane.box.clientHeight - 2 * MARGIN);
    return pixels > NEAR ? undefined : this.insert(time, this.offsetAt(time), true);
  }

  remove(index: number): void {
    const { edit, key } = this.places[index];
    this.put(edit, this.edits[edit].keys.filter((_, k) => k !== key));
  }

  done(): void {
    this.history.endGesture();
    this.layout();
  }

  layout(): void {
    const { take, lane } = this;
    if (!take) return;
    const frames = this.frames();
    const draw = (value: (time: number) => number) =>
      frames.map((f) => `${lane.x(f / take.fps)},${lane.y(this.levelOf(value(f / take.fps)))}`).join(" ");
    this.before.setAttribute("points", draw((time) => this.valueAt(time, [])));
    this.after.setAttribute("points", draw((time) => this.shownAt(time)));
    lane.layout();
  }

  at(time: number): void {
    const x = String(this.lane.x(time));
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", "0"], ["y2", String(this.lane.box.clientHeight)]]) {
      this.head.setAttribute(name, value);
    }
  }

  private get layers(): readonly Layer[] {
    return this.history.edit.layers;
  }

  private get edits(): readonly LayerEdit[] {
    return this.layers[this.active]?.edits ?? [];
  }

  /** Keys of the offsets of the target in the layer that is edited, by time. */
  private get places(): Place[] {
    const found = this.edits.flatMap((edit, k) =>
      edit.target === this.target && (edit.mode ?? "offset") === "offset" ? edit.keys.map((_, key) => ({ edit: k, key })) : []);
    return found.sort((a, b) => this.edits[a.edit].keys[a.key][0] - this.edits[b.edit].keys[b.key][0]);
  }

  private change(layers: readonly Layer[], gesture = ""): void {
    this.history.change({ layers }, gesture);
  }

  /** Put keys into an edit of the active layer; an edit without keys goes. */
  private put(place: number, keys: readonly Key[], gesture = ""): void {
    const edits = this.edits.map((edit, k) => (k === place ? withKeys(edit, keys) : edit)).filter((edit) => edit.keys.length);
    this.change(this.layers.map((layer, k) => (k === this.active ? { ...layer, edits } : layer)), gesture);
  }

  /** A key at the nearest frame. Of a drag, and of an edit that is new, a key to either side holds the rest. */
  private insert(seconds: number, value: number, isDrag = false): number {
    const { fps, frames } = this.take!, frame = Math.min(Math.max(Math.round(seconds * fps), 0), frames - 1), time = frame / fps;
    const layers = this.layers.length ? this.layers : [{ schema: SCHEMA, name: "edits", edits: [] }];
    const { edits } = layers[this.active], at = edits.findIndex((edit) =>
      edit.target === this.target && (edit.mode ?? "offset") === "offset" && spanOf(edit)[0] <= time && time <= spanOf(edit)[1]);
    const edit = edits[at] as LayerEdit | undefined, half = 0.5 / fps, reach = Math.max(Math.round(Number(this.reach.value)), 1);
    const keys: Key[] = (edit?.keys ?? []).filter((key) => Math.abs(key[0] - time) > half);
    for (const sign of edit && !isDrag ? [] : [-1, 1]) {
      const side = Math.min(Math.max(frame + sign * reach, 0), frames - 1) / fps, slope = edit ? slopeAt(edit, side) : 0;
      const [first, last] = edit ? spanOf(edit) : [0, this.take!.seconds];
      const isHeld = keys.some(([t]) => sign * (t - time) > 0 && sign * (t - side) < half);
      if (side !== time && !isHeld && side >= first && side <= last) keys.push(edit ? [side, curveAt(edit, side), slope, slope] : [side, 0]);
    }
    keys.push([time, value]);
    keys.sort((a, b) => a[0] - b[0]);
    const made = withKeys(edit ?? { target: this.target, mode: "offset", keys: [] }, keys);
    const next = at < 0 ? [...edits, made] : edits.map((edit, k) => (k === at ? made : edit));
    const index = () => this.places.findIndex(({ edit, key }) => this.edits[edit].keys[key][0] === time);
    const now = layers.map((layer, k) => (k === this.active ? { ...layer, edits: next } : layer));
    this.change(now, isDrag ? "grab" : "");
    const place = index();
    if (isDrag) this.history.renameGesture(`layer ${this.target} ${place}`);
    return place;
  }

  private addLayer(): void {
    const name = `edits ${this.layers.length + 1}`;
    this.active = this.layers.length;
    this.change([...this.layers, { schema: SCHEMA, name, edits: [] }]);
  }

  private row(layer: Layer, place: number): HTMLElement {
    const row = document.createElement("li"), name = layer.name || `layer ${place + 1}`;
    const replaced = (part: Partial<Layer>) => this.layers.map((other, k) => (k === place ? { ...other, ...part } : other));
    const moved = (to: number) => {
      const others = this.layers.filter((_, k) => k !== place);
      this.active = to;
      this.change([...others.slice(0, to), layer, ...others.slice(to)]);
    };
    const choose = button(name, () => {
      this.active = place;
      this.edited();
    });
    const mute = button("Mute", () => this.change(replaced({ muted: !layer.muted })));
    const up = button("↑", () => moved(place - 1)), down = button("↓", () => moved(place + 1));
    const drop = button("×", () => this.change(this.layers.filter((_, k) => k !== place)));
    const labels: [HTMLElement, string][] = [
      [choose, `Edit in ${name}`], [mute, `Mute ${name}`], [up, `${name} earlier`], [down, `${name} later`], [drop, `Remove ${name}`],
    ];
    for (const [element, label] of labels) {
      element.setAttribute("aria-label", label);
      element.title = label;
    }
    choose.setAttribute("aria-pressed", String(place === this.active));
    mute.setAttribute("aria-pressed", String(!!layer.muted));
    up.disabled = place === 0;
    down.disabled = place === this.layers.length - 1;
    const count = document.createElement("span");
    count.textContent = `${layer.edits.length} edit${layer.edits.length === 1 ? "" : "s"}`;
    row.append(choose, mute, up, down, drop, count);
    return row;
  }

  private get isControl(): boolean {
    return this.board.controls.includes(this.target);
  }

  /** Value of the target with layers: of a region the mean of its controls. */
  private valueAt(time: number, layers: readonly Layer[]): number {
    const take = this.take!, frame = Math.min(Math.max(Math.round(time * take.fps), 0), take.frames - 1);
    const row = take.frame(frame, layers), columns = columnsOf(this.board, this.target);
    return columns.reduce((sum, c) => sum + row[c], 0) / columns.length;
  }

  private shownAt(time: number): number {
    return this.valueAt(time, this.layers);
  }

  /** Offset of the layer that is edited. */
  private offsetAt(time: number): number {
    return this.places.length ? this.edits.filter((edit) => edit.target === this.target && (edit.mode ?? "offset") === "offset")
      .reduce((sum, edit) => sum + (time >= spanOf(edit)[0] && time <= spanOf(edit)[1] ? curveAt(edit, time) : 0), 0) : 0;
  }

  /** The offset that brings the target to a level at a time. */
  private offsetOf(time: number, level: number): number {
    const [low, high] = this.range, value = low + level * (high - low);
    const offset = value - this.shownAt(time) + this.offsetAt(time);
    return Math.round(Math.min(Math.max(offset, low - high), high - low) * 1000) / 1000;
  }

  private levelOf(value: number): number {
    const [low, high] = this.range;
    return (value - low) / (high - low);
  }

  private get range(): [number, number] {
    const columns = columnsOf(this.board, this.target), { minimum, maximum } = this.board;
    return [Math.min(...columns.map((c) => minimum[c])), Math.max(...columns.map((c) => maximum[c]))];
  }

  /** Frames of the span, at most one for each pixel. */
  private frames(): number[] {
    const { fps, frames } = this.take!, { start, end } = this.span;
    const first = Math.max(Math.floor(start * fps), 0), last = Math.min(Math.ceil(end * fps), frames - 1);
    const step = Math.max(1, Math.floor((last - first) / Math.max(this.lane.width, 1)));
    return Array.from({ length: Math.floor((last - first) / step) + 1 }, (_, k) => first + k * step);
  }
}
