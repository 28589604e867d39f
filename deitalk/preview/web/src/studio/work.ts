/** One line of progress for work that takes over a moment, with its end by Cancel. */

import { $, button, messageOf, notice } from "../dom";
import type { Progress } from "./service";

const SHOWN_AFTER_MS = 300;
const TICK_MS = 100;

export class Work {
  private current?: AbortController;
  private readonly row = document.createElement("div");
  private readonly bar = document.createElement("progress");
  private readonly label = document.createElement("span");

  constructor() {
    this.row.className = "work";
    this.row.hidden = true;
    this.row.append(this.bar, this.label, button("Cancel", () => this.cancel()));
    $("works").append(this.row);
  }

  get isBusy(): boolean {
    return this.current !== undefined;
  }

  cancel(): void {
    this.current?.abort();
  }

  /** Do work that replaces any before it; undefined if it was replaced, cancelled or failed. */
  async run<T>(label: string, task: (progress: Progress, signal: AbortSignal) => Promise<T>): Promise<T | undefined> {
    this.cancel();
    const control = (this.current = new AbortController()), began = performance.now();
    const { bar } = this;
    bar.removeAttribute("value");
    bar.setAttribute("aria-label", label);
    const timer = setInterval(() => {
      const took = performance.now() - began;
      this.row.hidden = took < SHOWN_AFTER_MS;
      this.label.textContent = `${label}, ${(took / 1000).toFixed(1)} s`;
    }, TICK_MS);
    notice("");
    try {
      const progress = (share?: number) => (share === undefined ? bar.removeAttribute("value") : (bar.value = share));
      const result = await task(progress, control.signal);
      return control.signal.aborted ? undefined : result;
    } catch (error) {
      if (!control.signal.aborted) notice(messageOf(error));
      return undefined;
    } finally {
      clearInterval(timer);
      if (this.current === control) {
        this.current = undefined;
        this.row.hidden = true;
      }
    }
  }
}
