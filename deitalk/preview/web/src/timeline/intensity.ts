/** Waveform, emotion band and the intensity curve with its draggable points. */

import { MAX_INTENSITY, type Take } from "./take";

const COLORS: Record<string, string> = {
  neutral: "#969eaa", angry: "#e2564a", happy: "#f5be42", sad: "#548edc", surprised: "#b074dc",
};
const SVG = "http://www.w3.org/2000/svg";
const HEIGHT = 90;

export function samplesOf(wav: Uint8Array): Int16Array {
  return new Int16Array(wav.buffer.slice(wav.byteOffset + 44, wav.byteOffset + 44 + ((wav.length - 44) & ~1)));
}

/** The waveform, drawn once per width, with the playhead over it. */
export class SoundView {
  private readonly picture = document.createElement("canvas");
  private key = "";

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly samples: Int16Array,
    private readonly share: number,
  ) {}

  at(time: number): void {
    const { canvas, picture } = this;
    const key = `${canvas.clientWidth} ${getComputedStyle(canvas).color}`;
    if (key !== this.key) {
      this.key = key;
      picture.width = canvas.width = canvas.clientWidth;
      picture.height = canvas.height;
      this.draw();
    }
    const pen = canvas.getContext("2d")!;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    if (canvas.width) pen.drawImage(picture, 0, 0);
    pen.fillStyle = getComputedStyle(document.body).color;
    pen.fillRect(time * canvas.width, 0, 2, canvas.height);
  }

  private draw(): void {
    const { picture, samples } = this;
    const width = picture.width * this.share, height = picture.height;
    const pen = picture.getContext("2d")!;
    pen.fillStyle = getComputedStyle(this.canvas).color;
    const loudest = samples.reduce((m, x) => Math.max(m, Math.abs(x)), 1);
    for (let x = 0; x < width; x++) {
      const a = Math.floor((x / width) * samples.length);
      const b = Math.max(a + 1, Math.floor(((x + 1) / width) * samples.length));
      let low = 0, high = 0;
      for (let k = a; k < b; k++) {
        low = Math.min(low, samples[k]);
        high = Math.max(high, samples[k]);
      }
      const top = (0.5 - (0.48 * high) / loudest) * height;
      pen.fillRect(x, top, 1, Math.max(1, (0.48 * (high - low) * height) / loudest));
    }
  }
}

export function drawEmotion(canvas: HTMLCanvasElement, take: Take): void {
  const width = (canvas.width = canvas.clientWidth);
  const pen = canvas.getContext("2d")!;
  const n = take.emotions.length;
  for (let x = 0; take.emotion && x < width; x++) {
    const frame = Math.round((x / width) * (take.frames - 1));
    take.emotions.forEach((name, k) => {
      pen.globalAlpha = take.emotion![frame * n + k];
      pen.fillStyle = COLORS[name];
      pen.fillRect(x, 0, 1, canvas.height);
    });
  }
}

export class IntensityEditor {
  private readonly line = document.createElementNS(SVG, "polyline");
  private readonly predicted = document.createElementNS(SVG, "polyline");
  private readonly head = document.createElementNS(SVG, "line");
  private dots: SVGCircleElement[] = [];
  private readonly top: number;

  constructor(
    private readonly svg: SVGSVGElement,
    private readonly take: Take,
    private readonly changed: () => void,
  ) {
    const peak = take.intensity ? Math.max(...take.intensity) : 1;
    this.top = Math.min(MAX_INTENSITY, Math.max(1.5, peak * 1.5));
    this.predicted.classList.add("predicted");
    this.head.classList.add("head");
    svg.replaceChildren(this.predicted, this.line, this.head);
    this.build();
  }

  build(): void {
    this.dots.forEach((dot) => dot.remove());
    this.dots = this.take.points.map((_, k) => this.dot(k));
    this.svg.append(...this.dots);
    this.layout();
  }

  private dot(k: number): SVGCircleElement {
    const dot = document.createElementNS(SVG, "circle");
    dot.setAttribute("r", "5");
    dot.setAttribute("tabindex", this.take.isEditable ? "0" : "-1");
    dot.setAttribute("role", "slider");
    dot.setAttribute("aria-valuemin", "0");
    dot.setAttribute("aria-valuemax", String(MAX_INTENSITY));
    if (!this.take.isEditable) return dot;
    dot.addEventListener("pointerdown", (event) => dot.setPointerCapture(event.pointerId));
    dot.addEventListener("pointermove", (event) => {
      if (!dot.hasPointerCapture(event.pointerId)) return;
      const box = this.svg.getBoundingClientRect();
      this.set(k, (1 - (event.clientY - box.top) / box.height) * this.top);
    });
    dot.addEventListener("keydown", (event) => {
      const step = { ArrowUp: 0.05, ArrowDown: -0.05 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      this.set(k, this.take.points[k].value + step);
    });
    return dot;
  }

  private set(k: number, value: number): void {
    this.take.isEdited = true;
    this.take.points[k].value = Math.min(Math.max(value, 0), Math.min(this.top, MAX_INTENSITY));
    this.layout();
    this.changed();
  }

  layout(): void {
    const width = this.svg.clientWidth, last = Math.max(this.take.seconds, 1e-6);
    const x = (t: number) => (t / last) * width;
    const y = (v: number) => HEIGHT * (1 - v / this.top);
    this.take.points.forEach((p, k) => {
      const dot = this.dots[k];
      dot.setAttribute("cx", String(x(p.time)));
      dot.setAttribute("cy", String(y(p.value)));
      dot.setAttribute("aria-valuenow", p.value.toFixed(2));
      dot.setAttribute("aria-label", `Intensity at ${p.time.toFixed(1)} s`);
    });
    this.line.setAttribute("points", this.take.points.map((p) => `${x(p.time)},${y(p.value)}`).join(" "));
    if (this.take.intensity) {
      const all = Array.from(this.take.intensity, (v, f) => `${x(f / this.take.fps)},${y(v)}`);
      this.predicted.setAttribute("points", all.join(" "));
    }
  }

  at(share: number): void {
    const x = String(share * this.svg.clientWidth);
    for (const [name, value] of [["x1", x], ["x2", x], ["y1", "0"], ["y2", String(HEIGHT)]]) {
      this.head.setAttribute(name, value);
    }
  }
}
