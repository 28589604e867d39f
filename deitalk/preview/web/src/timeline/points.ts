/** Points of a lane that are dragged both ways, added, deleted and moved by keys. */

import type { Span } from "./span";

const SVG = "http://www.w3.org/2000/svg";
/** Distance of levels 0 and 1 from the edges of the lane, pixels. */
export const MARGIN = 10;
/** Motion of a pressed pointer from which it drags, pixels. */
const DRAG = 3;

/** `level` is the height, 0 at the bottom to 1. */
export interface LanePoint {
  time: number;
  level: number;
  label: string;
  color?: string;
}

export interface PointOwner {
  points(): LanePoint[];
  move(index: number, time: number, level: number): void;
  /** Index of the new point. */
  add(time: number, level: number): number;
  remove(index: number): void;
  /** Index of the point that a drag from beside all points takes; undefined: none. */
  grab?(time: number, level: number): number | undefined;
  /** The end of a drag, or of a press of a key. */
  done(): void;
  /** Another point has the focus, or none. */
  focused?(): void;
  /** Steps of the arrow keys: seconds, which also are the least between two points, and level. */
  steps(): [number, number];
}

export function svg<K extends keyof SVGElementTagNameMap>(name: K, className = ""): SVGElementTagNameMap[K] {
  const made = document.createElementNS(SVG, name);
  if (className) made.setAttribute("class", className);
  return made;
}

export class PointLane {
  private dots: SVGCircleElement[] = [];
  /** The press that may become a drag. */
  private press?: PointerEvent;
  /** The point that is dragged, and how far its middle is from the pointer. */
  private drag?: { index: number; x: number; y: number };
  isEditable = false;

  constructor(
    readonly box: SVGSVGElement,
    private readonly span: Span,
    private readonly owner: PointOwner,
  ) {
    addEventListener("pointerdown", (event) => {
      const isHere = this.isEditable && !event.button && box.contains(event.target as Node);
      if (!this.drag) this.press = isHere ? event : undefined;
    }, true);
    box.addEventListener("pointermove", (event) => this.pull(event));
    box.addEventListener("lostpointercapture", (event) => {
      if (this.drag && event.target === this.dots[this.drag.index]) this.release();
    });
    box.addEventListener("dblclick", (event) => {
      const index = this.dots.indexOf(event.target as SVGCircleElement);
      if (index >= 0) this.remove(index);
      else if (this.isEditable) this.focus(this.owner.add(...this.place(event.clientX, event.clientY)));
    });
  }

  get isDragged(): boolean {
    return this.drag !== undefined;
  }

  /** Index of the point in focus; -1: none. */
  get selected(): number {
    return this.dots.indexOf(document.activeElement as unknown as SVGCircleElement);
  }

  get width(): number {
    return this.box.clientWidth;
  }

  y(level: number): number {
    return MARGIN + (1 - level) * (this.box.clientHeight - 2 * MARGIN);
  }

  x(time: number): number {
    return this.span.x(time, this.width);
  }

  focus(index: number): void {
    this.layout();
    this.dots[Math.min(index, this.dots.length - 1)]?.focus();
  }

  layout(): void {
    const points = this.isEditable ? this.owner.points() : [];
    if (points.length !== this.dots.length) this.press = this.drag = undefined;
    while (this.dots.length > points.length) this.dots.pop()!.remove();
    while (this.dots.length < points.length) this.dots.push(this.dot(this.dots.length));
    points.forEach((point, k) => {
      const dot = this.dots[k], x = this.x(point.time);
      dot.setAttribute("cx", String(x));
      dot.setAttribute("cy", String(this.y(point.level)));
      dot.setAttribute("aria-valuenow", point.level.toFixed(2));
      dot.setAttribute("aria-valuetext", point.label);
      dot.setAttribute("aria-label", `Point ${k + 1}`);
      dot.style.fill = point.color ?? "";
      dot.style.display = x < -1 || x > this.width + 1 ? "none" : "";
    });
  }

  /** Move the pressed point with the pointer, once that has moved. */
  private pull(event: PointerEvent): void {
    const { press } = this;
    if (event.pointerId !== press?.pointerId) return;
    if (!(event.buttons & 1)) return this.release();
    if (!this.drag) {
      if (Math.hypot(event.clientX - press.clientX, event.clientY - press.clientY) < DRAG) return;
      this.take(press);
    }
    if (this.drag) this.move(this.drag.index, ...this.place(event.clientX + this.drag.x, event.clientY + this.drag.y));
  }

  private take(press: PointerEvent): void {
    const dot = this.dots.indexOf(press.target as SVGCircleElement);
    const index = dot >= 0 ? dot : this.owner.grab?.(...this.place(press.clientX, press.clientY));
    this.press = index === undefined ? undefined : press;
    if (index === undefined) return;
    this.focus(index);
    const box = this.box.getBoundingClientRect(), { time, level } = this.owner.points()[index];
    this.drag = { index, x: box.left + this.x(time) - press.clientX, y: box.top + this.y(level) - press.clientY };
    this.dots[index].setPointerCapture(press.pointerId);
  }

  private release(): void {
    this.press = this.drag = undefined;
    this.owner.done();
  }

  private place(x: number, y: number): [time: number, level: number] {
    const box = this.box.getBoundingClientRect();
    const level = 1 - (y - box.top - MARGIN) / (box.height - 2 * MARGIN);
    return [this.span.time(x - box.left, box.width), Math.min(Math.max(level, 0), 1)];
  }

  /** Move a point, not past its neighbours. */
  private move(index: number, time: number, level: number): void {
    const points = this.owner.points(), [gap] = this.owner.steps();
    const low = index ? points[index - 1].time + gap : 0;
    const high = index < points.length - 1 ? points[index + 1].time - gap : this.span.total;
    const at = low <= high ? Math.min(Math.max(time, low), high) : points[index].time;
    this.owner.move(index, at, Math.min(Math.max(level, 0), 1));
  }

  private dot(index: number): SVGCircleElement {
    const dot = svg("circle");
    for (const [name, value] of Object.entries({ r: 6, tabindex: 0, role: "slider", "aria-valuemin": 0, "aria-valuemax": 1 })) {
      dot.setAttribute(name, String(value));
    }
    for (const name of ["focus", "blur"]) dot.addEventListener(name, () => this.owner.focused?.());
    dot.addEventListener("keydown", (event) => this.key(event, index));
    dot.addEventListener("keyup", () => this.isDragged || this.owner.done());
    this.box.append(dot);
    return dot;
  }

  private key(event: KeyboardEvent, index: number): void {
    const [seconds, level] = this.owner.steps(), point = this.owner.points()[index];
    const by = { ArrowLeft: [-seconds, 0], ArrowRight: [seconds, 0], ArrowUp: [0, level], ArrowDown: [0, -level] }[event.key];
    const isDelete = event.key === "Delete" || event.key === "Backspace";
    if (!by && !isDelete) return;
    event.preventDefault();
    event.stopPropagation();
    if (isDelete) this.remove(index);
    else this.move(index, point.time + by![0], point.level + by![1]);
  }

  private remove(index: number): void {
    this.owner.remove(index);
    this.owner.done();
    this.focus(index);
  }
}
