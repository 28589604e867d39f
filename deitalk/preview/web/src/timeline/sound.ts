/** The waveform of the span with the loop's range and the playhead. */

import type { Span } from "./span";

const WAV_HEADER_BYTES = 44;

/** Samples of a 16-bit mono WAV, and their rate. */
export function samplesOf(wav: Uint8Array): { samples: Int16Array; rate: number } {
  const from = wav.byteOffset + WAV_HEADER_BYTES, bytes = (wav.length - WAV_HEADER_BYTES) & ~1;
  const rate = new DataView(wav.buffer, wav.byteOffset).getUint32(24, true);
  return { samples: new Int16Array(wav.buffer.slice(from, from + bytes)), rate };
}

export class SoundView {
  private readonly picture = document.createElement("canvas");
  private samples: Int16Array = new Int16Array(0);
  private rate = 1;
  private key = "";

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly span: Span,
    private readonly range: () => [number, number] | undefined,
  ) {}

  load(wav: Uint8Array | null): void {
    const { samples, rate } = wav ? samplesOf(wav) : { samples: new Int16Array(0), rate: 1 };
    this.samples = samples;
    this.rate = rate;
    this.key = "";
  }

  at(time: number): void {
    const { canvas, picture, span } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((pixels) => Math.round(pixels * devicePixelRatio));
    const key = `${width} ${getComputedStyle(canvas).color} ${span.start} ${span.end}`;
    if (key !== this.key) {
      this.key = key;
      picture.width = canvas.width = width;
      picture.height = canvas.height = height;
      if (width) this.draw();
    }
    const pen = canvas.getContext("2d")!;
    pen.clearRect(0, 0, width, height);
    const range = this.range();
    if (range) {
      const [from, to] = range.map((seconds) => span.x(seconds, width));
      pen.fillStyle = "#8885";
      pen.fillRect(from, 0, to - from, height);
    }
    if (width) pen.drawImage(picture, 0, 0);
    pen.fillStyle = getComputedStyle(document.body).color;
    pen.fillRect(span.x(time, width), 0, 2 * devicePixelRatio, height);
  }

  private draw(): void {
    const { picture, samples, span, rate } = this, { width, height } = picture;
    const pen = picture.getContext("2d")!;
    pen.fillStyle = getComputedStyle(this.canvas).color;
    const loudest = samples.reduce((m, x) => Math.max(m, Math.abs(x)), 1);
    const place = (x: number) => Math.floor((span.start + (x / width) * span.seconds) * rate);
    for (let x = 0; x < width; x++) {
      const from = place(x), to = Math.min(Math.max(from + 1, place(x + 1)), samples.length);
      if (from >= samples.length) break;
      let low = 0, high = 0;
      for (let k = from; k < to; k++) {
        low = Math.min(low, samples[k]);
        high = Math.max(high, samples[k]);
      }
      const top = (0.5 - (0.48 * high) / loudest) * height;
      pen.fillRect(x, top, 1, Math.max(1, (0.48 * (high - low) * height) / loudest));
    }
  }
}
