/** Gain, mute and solo of the face's regions. */

import { type History, MAX_GAIN } from "../data/edit";
import { button } from "../dom";

/** A slider of one of the factors of an edit, 0 to 2; double click: 1. */
export function factorSlider(label: string, history: History, part: "gains" | "life", name: string) {
  const slider = document.createElement("input");
  const set = (value: number, gesture?: string) =>
    history.change({ [part]: { ...history.edit[part], [name]: value } }, gesture);
  Object.assign(slider, { type: "range", min: "0", max: String(MAX_GAIN), step: "0.05" });
  slider.setAttribute("aria-label", label);
  slider.addEventListener("input", () => set(Number(slider.value), label));
  slider.addEventListener("change", () => history.endGesture());
  slider.addEventListener("dblclick", () => set(1));
  const show = () => {
    const value = history.edit[part][name] ?? 1;
    slider.value = String(value);
    slider.title = `${label}: ${value.toFixed(2)}; double click: 1`;
  };
  return { slider, show };
}

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
    const { slider, show } = factorSlider(`Gain of ${region}`, this.history, "gains", region);
    solo.setAttribute("aria-label", `Only ${region}`);
    mute.title = `Mute ${region}`;
    solo.title = `Only ${region}; again: all`;
    row.append(mute, solo, slider);
    this.rows.push(() => {
      show();
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
