/** Playback: buttons, keys and scrubbing set one clock; the loop draws the frame that is due. */

import type { Clock } from "./clock";
import { $, timeCode } from "./page";

const KEYS: [string, string][] = [
  ["Space", "play or pause"], [", .", "one frame back, on"], ["Home End", "to the start, to the end"], ["L", "loop"],
  ["- +", "slower, faster"], ["1 2 3 4", "face, three quarter, side, mouth"], ["O", "open a GLB"],
  ["?", "this list"], ["↑ ↓", "move the intensity point in focus"],
];

export class Transport {
  /** Time of the shown frame, seconds. */
  shown = 0;
  /** Drawing time of a frame, seconds; the frame drawn is the one due at the end of drawing. */
  private lead = 0;

  constructor(
    private readonly clock: Clock,
    private readonly fps: number,
    private readonly draw: (seconds: number) => void,
    private readonly moreKeys: Record<string, () => void>,
  ) {
    this.bindButtons();
    this.bindScrubbing($<HTMLCanvasElement>("sound"));
    this.bindKeys();
    this.bindFocus();
    this.loop();
  }

  get time(): number {
    return this.clock.time;
  }

  seek(seconds: number): void {
    this.clock.seek(seconds);
    this.show(Math.min(Math.max(seconds, 0), this.clock.seconds));
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

  private step(frames: number): void {
    this.clock.pause();
    this.seek((Math.round(this.clock.time * this.fps) + frames) / this.fps);
    this.labelPlay();
  }

  private async toggle(): Promise<void> {
    const started = this.clock.playing ? this.clock.pause() : this.clock.play();
    this.labelPlay();
    await started;
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
    if (clock.playing && clock.isAtEnd) this.atEnd();
    requestAnimationFrame(this.loop);
  };

  private showAhead(): void {
    const began = performance.now();
    this.show(Math.min(this.clock.time + this.lead * this.clock.rate, this.clock.seconds));
    setTimeout(() => {
      const took = Math.min((performance.now() - began) / 1000, 0.1);
      this.lead += 0.2 * (took - this.lead);
    }, 0);
  }

  private atEnd(): void {
    if ($<HTMLInputElement>("loop").checked) void this.clock.play();
    else this.clock.pause();
    this.labelPlay();
  }

  private bindButtons(): void {
    $("play").addEventListener("click", () => void this.toggle());
    $("back").addEventListener("click", () => this.step(-1));
    $("next").addEventListener("click", () => this.step(1));
    $<HTMLSelectElement>("speed").addEventListener("change", (e) =>
      this.clock.setRate(Number((e.target as HTMLSelectElement).value)));
    $("offset").addEventListener("input", () => this.show(this.clock.time));
    const dialog = $<HTMLDialogElement>("help");
    $("help-button").addEventListener("click", () => dialog.showModal());
    for (const [key, what] of KEYS) {
      const term = document.createElement("dt"), meaning = document.createElement("dd");
      const cap = document.createElement("kbd");
      cap.textContent = key;
      meaning.textContent = what;
      term.append(cap);
      $("keys").append(term, meaning);
    }
  }

  private bindScrubbing(sound: HTMLCanvasElement): void {
    const scrub = (e: PointerEvent) => {
      const box = sound.getBoundingClientRect();
      this.seek(Math.min(Math.max((e.clientX - box.left) / box.width, 0), 1) * this.clock.seconds);
    };
    sound.addEventListener("pointerdown", (e) => { sound.setPointerCapture(e.pointerId); scrub(e); });
    sound.addEventListener("pointermove", (e) => { if (sound.hasPointerCapture(e.pointerId)) scrub(e); });
  }

  /** A control that was clicked gives the keys back to playback; one reached by Tab keeps its own. */
  private bindFocus(): void {
    let byPointer = false;
    addEventListener("pointerdown", () => (byPointer = true), true);
    addEventListener("keydown", () => (byPointer = false), true);
    const release = (event: Event) => {
      const target = event.target as HTMLElement;
      if (byPointer && !isText(target)) (target.closest("button, select, input, summary") as HTMLElement)?.blur();
    };
    addEventListener("click", (event) => (event.target as HTMLElement).tagName !== "SELECT" && release(event));
    addEventListener("change", release);
  }

  private bindKeys(): void {
    const speed = $<HTMLSelectElement>("speed");
    const change = (by: number) => {
      speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
      this.clock.setRate(Number(speed.value));
    };
    const actions: Record<string, () => void> = {
      " ": () => void this.toggle(), ",": () => this.step(-1), ".": () => this.step(1),
      ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1), Home: () => this.seek(0), End: () => this.seek(this.clock.seconds),
      l: () => $("loop").click(), "-": () => change(-1), "+": () => change(1),
      "?": () => $("help-button").click(), ...this.moreKeys,
    };
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || ownKeys(event.target as HTMLElement, event.key)) return;
      const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      event.preventDefault();
      action();
    });
  }
}

const isText = (target: HTMLElement) =>
  target.tagName === "TEXTAREA" || (target.tagName === "INPUT" && !/^(checkbox|range|button)$/.test((target as HTMLInputElement).type));

/** Whether an element that has the focus uses a key itself. */
function ownKeys(target: HTMLElement, key: string): boolean {
  if (isText(target)) return true;
  if (key === " ") return /^(BUTTON|SUMMARY|INPUT)$/.test(target.tagName);
  return /^(SELECT|INPUT)$/.test(target.tagName) && /^(Arrow|Home|End)/.test(key);
}
