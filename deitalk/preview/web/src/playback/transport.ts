/** Playback: buttons, keys and scrubbing set one clock; the loop draws the frame that is due. */

import { $, timeCode } from "../dom";
import type { Span } from "../timeline/span";
import type { Clock } from "./clock";
import { bindFocus, bindKeys, listKeys } from "./keys";

export class Transport {
  /** Time of the shown frame, seconds. */
  shown = 0;
  fps = 30;
  /** What Loop repeats, seconds; all of the take without it. */
  range?: [number, number];
  /** Drawing time of a frame, seconds; the frame drawn is the one due at the end of drawing. */
  private lead = 0;

  constructor(
    private readonly clock: Clock,
    private readonly span: Span,
    private readonly draw: (seconds: number) => void,
    moreKeys: Record<string, () => void>,
  ) {
    this.bindButtons();
    this.bindScrubbing($<HTMLCanvasElement>("sound"));
    this.bindKeys(moreKeys);
    bindFocus();
    listKeys();
    this.loop();
  }

  get time(): number {
    return this.clock.time;
  }

  seek(seconds: number): void {
    const to = Math.min(Math.max(seconds, 0), this.clock.seconds);
    this.clock.seek(to);
    this.span.follow(to);
    this.show(to);
  }

  show(seconds: number): void {
    this.shown = seconds;
    const frame = Math.min(Math.round(seconds * this.fps), Math.max(Math.ceil(this.clock.seconds * this.fps) - 1, 0));
    $("clock").textContent = `${timeCode(seconds)}  frame ${frame}`;
    const sound = $<HTMLCanvasElement>("sound");
    sound.setAttribute("aria-valuenow", seconds.toFixed(2));
    sound.setAttribute("aria-valuemax", this.clock.seconds.toFixed(2));
    this.draw(seconds);
  }

  /** Repeat a range, or all of the take again. */
  setRange(range?: [number, number]): void {
    this.range = range && range[1] - range[0] > 1 / this.fps ? range : undefined;
    if (this.range) $<HTMLInputElement>("loop").checked = true;
    $("range").textContent = this.range ? this.range.map(timeCode).join(" – ") : "";
    $<HTMLButtonElement>("no-range").disabled = !this.range;
    this.show(this.shown);
  }

  pause(): void {
    this.clock.pause();
    this.labelPlay();
  }

  /** Play, if the browser allows it; a start that a pause cut short is none to end. */
  play(): void {
    this.clock.play().catch((error) => error.name !== "AbortError" && this.pause());
    this.labelPlay();
  }

  private step(frames: number): void {
    this.pause();
    this.seek((Math.round(this.clock.time * this.fps) + frames) / this.fps);
  }

  private toggle(): void {
    if (this.clock.playing) this.pause();
    else this.play();
  }

  private labelPlay(): void {
    const button = $("play");
    button.textContent = this.clock.playing ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(this.clock.playing));
  }

  private loop = (): void => {
    const { clock } = this;
    if (clock.playing) this.showAhead();
    else if (Math.abs(clock.time - this.shown) > 1e-3) this.show(clock.time);
    if (clock.playing) this.atEnd();
    requestAnimationFrame(this.loop);
  };

  private showAhead(): void {
    const began = performance.now();
    const due = Math.min(this.clock.time + this.lead * this.clock.rate, this.clock.seconds);
    if (!this.span.isWhole) this.span.follow(due);
    this.show(due);
    setTimeout(() => {
      const took = Math.min((performance.now() - began) / 1000, 0.1);
      this.lead += 0.2 * (took - this.lead);
    }, 0);
  }

  /** At the end of the take or of the range: begin again, or stop. */
  private atEnd(): void {
    const { clock, range } = this, isLoop = $<HTMLInputElement>("loop").checked;
    if (isLoop && range && clock.time >= range[1]) clock.seek(range[0]);
    if (!clock.isAtEnd) return;
    if (isLoop) {
      clock.seek(range?.[0] ?? 0);
      this.play();
    } else this.pause();
  }

  private bindButtons(): void {
    $("play").addEventListener("click", () => this.toggle());
    $("back").addEventListener("click", () => this.step(-1));
    $("next").addEventListener("click", () => this.step(1));
    $<HTMLSelectElement>("speed").addEventListener("change", (e) =>
      this.clock.setRate(Number((e.target as HTMLSelectElement).value)));
    $("offset").addEventListener("input", () => this.show(this.clock.time));
    $("range-in").addEventListener("click", () => this.mark(0));
    $("range-out").addEventListener("click", () => this.mark(1));
    $("no-range").addEventListener("click", () => this.setRange());
  }

  /** Set one end of the loop's range at the playhead. */
  private mark(end: 0 | 1): void {
    const range: [number, number] = this.range ? [...this.range] : [0, this.clock.seconds];
    range[end] = this.clock.time;
    if (range[0] >= range[1]) range[1 - end] = end ? 0 : this.clock.seconds;
    this.setRange(range);
  }

  private bindScrubbing(sound: HTMLCanvasElement): void {
    let from: number | undefined;
    const timeOf = (e: PointerEvent) => {
      const box = sound.getBoundingClientRect();
      return this.span.time(Math.min(Math.max(e.clientX - box.left, 0), box.width), box.width);
    };
    const scrub = (e: PointerEvent) => {
      const time = timeOf(e);
      if (from === undefined) this.seek(time);
      else this.setRange([Math.min(from, time), Math.max(from, time)]);
    };
    sound.addEventListener("pointerdown", (e) => {
      if (e.button) return;
      sound.setPointerCapture(e.pointerId);
      from = e.shiftKey ? timeOf(e) : undefined;
      scrub(e);
    });
    sound.addEventListener("pointermove", (e) => { if (sound.hasPointerCapture(e.pointerId)) scrub(e); });
  }

  private bindKeys(more: Record<string, () => void>): void {
    const speed = $<HTMLSelectElement>("speed");
    const change = (by: number) => {
      speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
      this.clock.setRate(Number(speed.value));
    };
    const click = (id: string) => () => $(id).click();
    bindKeys({
      " ": () => this.toggle(), ",": () => this.step(-1), ".": () => this.step(1),
      ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      Home: () => this.seek(0), End: () => this.seek(this.clock.seconds),
      l: click("loop"), "-": () => change(-1), "+": () => change(1), "?": click("help-button"),
      "[": () => this.mark(0), "]": () => this.mark(1),
      z: click("zoom-in"), x: click("zoom-out"), f: click("zoom-fit"), p: click("add-point"), ...more,
    });
  }
}
