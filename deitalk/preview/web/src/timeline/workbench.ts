/** Tools for a take: draggable intensity, curves, muted regions, warnings. */

import { CurveLanes } from "./curves";
import type { Packed } from "./data";
import { $, button, timeCode } from "./page";
import type { Take } from "./take";
import { drawEmotion, IntensityEditor } from "./timeline";

const MOST_FOUND = 8;

/** Names that hold every word, shorter names first. */
export function findControls(names: string[], query: string): string[] {
  const words = query.toLowerCase().replace(/\bleft\b/g, "_l_").replace(/\bright\b/g, "_r_").split(/\s+/).filter(Boolean);
  if (!words.length) return [];
  const found = names.filter((name) => words.every((word) => name.toLowerCase().includes(word)));
  return found.sort((a, b) => a.length - b.length);
}

export class Workbench {
  private readonly editor: IntensityEditor;
  private readonly lanes: CurveLanes;
  private readonly regionButtons: (() => void)[] = [];
  private stale = 0;

  /** The timeline shows the first take; muted regions apply to all takes. */
  constructor(
    head: Packed,
    private readonly takes: Take[],
    audioSeconds: number,
    private readonly seek: (seconds: number) => void,
    private readonly refresh: () => void,
  ) {
    this.editor = new IntensityEditor($<SVGSVGElement>("intensity"), this.take, () => this.edited());
    this.lanes = new CurveLanes($("curves"), takes, head.facts.controls, seek);
    this.bindIntensity();
    this.bindSearch(head.facts.controls);
    const regions = [...new Set<string>(head.facts.regions)];
    for (const region of regions) this.addRegion(region, regions);
    this.regionButtons.forEach((show) => show());
    this.listWarnings(audioSeconds);
  }

  private get take(): Take {
    return this.takes[0];
  }

  at(seconds: number): void {
    this.editor.at(Math.min(seconds / this.take.seconds, 1));
    this.lanes.at(seconds);
    $("status").textContent = this.words(Math.min(Math.round(seconds * this.take.fps), this.take.frames - 1));
  }

  layout(): void {
    drawEmotion($<HTMLCanvasElement>("emotion"), this.take);
    this.editor.layout();
    this.lanes.resize();
  }

  private words(frame: number): string {
    const { take } = this, parts: string[] = [];
    if (take.emotion) {
      const n = take.emotions.length;
      const row = Array.from(take.emotion.subarray(frame * n, frame * n + n));
      parts.push(take.emotions[row.indexOf(Math.max(...row))]);
    }
    if (take.intensity) parts.push(`intensity ${take.intensityAt(frame).toFixed(2)} (mean ${take.meanIntensity.toFixed(2)})`);
    if (take.isEdited) parts.push("edited (a preview: animate again for the network's reading)");
    return parts.join(", ");
  }

  private edited(): void {
    this.refresh();
    clearTimeout(this.stale);
    this.stale = window.setTimeout(() => this.lanes.build(), 250);
  }

  private bindIntensity(): void {
    const { take } = this;
    $("reset").addEventListener("click", () => { take.reset(); this.editor.build(); this.edited(); });
    $("save").addEventListener("click", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([take.csv()], { type: "text/csv" }));
      link.download = "intensity.csv";
      link.click();
    });
    for (const id of ["reset", "save"]) $<HTMLButtonElement>(id).disabled = !take.isEditable;
  }

  /** Controls that hold every word of the search; Enter adds the first. */
  private bindSearch(controls: string[]): void {
    const search = $<HTMLInputElement>("search"), found = $("found");
    const matches = () => findControls(controls, search.value);
    const add = (name: string) => {
      this.lanes.add(name);
      search.value = "";
      found.replaceChildren();
      search.focus();
    };
    search.addEventListener("input", () => {
      const names = matches();
      found.replaceChildren(...names.slice(0, MOST_FOUND).map((name) => button(name, () => add(name))));
      if (search.value.trim() && !names.length) found.textContent = "no control has this in its name";
      if (names.length > MOST_FOUND) found.append(`and ${names.length - MOST_FOUND} more`);
    });
    search.addEventListener("keydown", (event) => {
      const [first] = matches();
      if (event.key === "Enter" && first) add(first);
    });
  }

  /** A region has a button that mutes it and one that mutes all others; the second press undoes. */
  private addRegion(region: string, regions: string[]): void {
    const others = regions.filter((name) => name !== region);
    const mute = button(region, () => {
      const isMuted = this.take.muted.has(region);
      this.mute(regions.filter((name) => (name === region ? !isMuted : this.take.muted.has(name))));
    });
    const solo = button("S", () => this.mute(this.isSolo(region, others) ? [] : others));
    mute.title = `Mute ${region}`;
    solo.title = `Only ${region}; again: all`;
    solo.setAttribute("aria-label", `Only ${region}`);
    const pair = document.createElement("span");
    pair.className = "region";
    pair.append(mute, solo);
    $("regions").append(pair);
    this.regionButtons.push(() => {
      mute.setAttribute("aria-pressed", String(!this.take.muted.has(region)));
      solo.setAttribute("aria-pressed", String(this.isSolo(region, others)));
    });
  }

  private isSolo(region: string, others: string[]): boolean {
    const { muted } = this.take;
    return !muted.has(region) && others.length > 0 && others.every((name) => muted.has(name));
  }

  private mute(regions: string[]): void {
    for (const take of this.takes) take.muted = new Set(regions);
    this.regionButtons.forEach((show) => show());
    this.edited();
  }

  private listWarnings(audioSeconds: number): void {
    const found = this.take.warnings(audioSeconds);
    const list = $("warnings");
    if (!found.length) list.append(Object.assign(document.createElement("li"), { textContent: "none" }));
    for (const { time, text } of found) {
      const item = document.createElement("li");
      item.append(button(timeCode(time), () => this.seek(time)), ` ${text}`);
      list.append(item);
    }
  }
}
