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
  /** The end of a drag. */
  done(): void;
  select?(index: number): void;
  /** The focus goes elsewhere. */
  leave?(to: Element | null): void;
  /** Steps of the arrow keys: seconds, level. */
  steps(): [number, number];
}

export function svg<K extends keyof SVGElementTagNameMap>(name: K, className = ""): SVGElementTagNameMap[K] {
  const made = document.createElementNS(SVG, name);
  if (className) made.setAttribute("class", className);
  return made;
}

export class PointLane {
  private dots: SVGCircleElement[] = [];
  isEditable = false;

  constructor(
    readonly box: SVGSVGElement,
    private readonly span: Span,
    private readonly owner: PointOwner,
  ) {
    let pressed: PointerEvent | undefined;
    addEventListener("pointerdown", (event) => {
      const isBeside = event.target instanceof Node && box.contains(event.target) && !(event.target instanceof SVGCircleElement);
      pressed = isBeside && this.isEditable && !event.button ? event : undefined;
    }, true);
    box.addEventListener("pointermove", (event) => {
      if (!pressed || !event.buttons || Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < DRAG) return;
      const index = this.owner.grab?.(...this.place(pressed));
      pressed = undefined;
      if (index === undefined) return;
      this.focus(index);
      this.dots[index].setPointerCapture(event.pointerId);
      this.owner.move(index, ...this.place(event));
    });
    box.addEventListener("dblclick", (event) => {
      if (!this.isEditable || event.target instanceof SVGCircleElement) return;
      const [time, level] = this.place(event);
      this.focus(this.owner.add(time, level));
    });
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
    while (this.dots.length > points.length) this.dots.pop()!.remove();
    while (this.dots.length < points.length) this.dots.push(this.dot(this.dots.length));
    points.forEach((point, k) => {
      const dot = this.dots[k];
      dot.setAttribute("cx", String(this.x(point.time)));
      dot.setAttribute("cy", String(this.y(point.level)));
      dot.setAttribute("aria-valuenow", point.level.toFixed(2));
      dot.setAttribute("aria-valuetext", point.label);
      dot.setAttribute("aria-label", `Point ${k + 1}`);
      dot.style.fill = point.color ?? "";
      const x = this.x(point.time);
      dot.style.display = x < -1 || x > this.width + 1 ? "none" : "";
    });
  }

  private place(event: MouseEvent): [number, number] {
    const box = this.box.getBoundingClientRect();
    const level = 1 - (event.clientY - box.top - MARGIN) / (box.height - 2 * MARGIN);
    return [this.span.time(event.clientX - box.left, box.width), Math.min(Math.max(level, 0), 1)];
  }

  private dot(index: number): SVGCircleElement {
    const dot = svg("circle");
    for (const [name, value] of Object.entries({ r: 6, tabindex: 0, role: "slider", "aria-valuemin": 0, "aria-valuemax": 1 })) {
      dot.setAttribute(name, String(value));
    }
    dot.addEventListener("pointerdown", (event) => {
      dot.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    dot.addEventListener("pointermove", (event) => {
      if (dot.hasPointerCapture(event.pointerId)) this.owner.move(index, ...this.place(event));
    });
    dot.addEventListener("pointerup", () => this.owner.done());
    dot.addEventListener("dblclick", () => this.remove(index));
    dot.addEventListener("focus", () => this.owner.select?.(index));
    dot.addEventListener("blur", (event) => this.owner.leave?.(event.relatedTarget as Element | null));
    dot.addEventListener("keydown", (event) => this.key(event, index));
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
    else this.owner.move(index, point.time + by![0], Math.min(Math.max(point.level + by![1], 0), 1));
  }

  private remove(index: number): void {
    this.owner.remove(index);
    this.owner.done();
    this.focus(index);
  }
}
