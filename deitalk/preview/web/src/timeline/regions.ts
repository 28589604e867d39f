/** Gain, mute and solo of the face's regions. */

import { type History, MAX_GAIN } from "../data/edit";
import { button } from "../dom";

export class Regions {
  private readonly rows: (() => void)[] = [];

  constructor(box: HTMLElement, private readonly regions: string[], private readonly history: History) {
    box.append(...regions.map((region) => this.row(region)));
    this.show();
  }

  show(): void {
    this.rows.forEach((show) => show());
  }

  /** A name that mutes, S for this region alone, and the gain; a second press undoes. */
  private row(region: string): HTMLElement {
    const row = document.createElement("span");
    row.className = "region";
    const mute = button(region, () => this.mute(this.regions.filter((r) => (r === region) !== this.muted.has(r))));
    const solo = button("S", () => this.mute(this.isSolo(region) ? [] : this.regions.filter((r) => r !== region)));
    const gain = document.createElement("input");
    Object.assign(gain, { type: "range", min: "0", max: String(MAX_GAIN), step: "0.05" });
    gain.addEventListener("input", () => {
      const gains = { ...this.history.edit.gains, [region]: Number(gain.value) };
      this.history.change({ gains }, `gain ${region}`);
    });
    gain.addEventListener("change", () => this.history.endGesture());
    gain.addEventListener("dblclick", () => this.history.change({ gains: { ...this.history.edit.gains, [region]: 1 } }));
    gain.setAttribute("aria-label", `Gain of ${region}`);
    solo.setAttribute("aria-label", `Only ${region}`);
    mute.title = `Mute ${region}`;
    solo.title = `Only ${region}; again: all`;
    row.append(mute, solo, gain);
    this.rows.push(() => {
      const value = this.history.edit.gains[region] ?? 1;
      gain.value = String(value);
      gain.title = `Gain of ${region}: ${value.toFixed(2)}; double click: 1`;
      mute.setAttribute("aria-pressed", String(!this.muted.has(region)));
      solo.setAttribute("aria-pressed", String(this.isSolo(region)));
    });
    return row;
  }

  private get muted(): Set<string> {
    return new Set(this.history.edit.muted);
  }

  private mute(regions: string[]): void {
    this.history.change({ muted: regions });
  }

  private isSolo(region: string): boolean {
    const { muted } = this;
    return !muted.has(region) && muted.size > 0 && muted.size === this.regions.length - 1;
  }
}
