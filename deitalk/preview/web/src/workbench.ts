/** Tools for a take: draggable intensity, curves, muted regions, warnings. */

import { CurveLanes } from "./curves";
import type { Packed } from "./data";
import { $, button, timeCode } from "./page";
import type { Take } from "./take";
import { drawEmotion, IntensityEditor } from "./timeline";

export class Workbench {
  private readonly editor: IntensityEditor;
  private readonly lanes: CurveLanes;
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
    this.lanes = new CurveLanes($("curves"), this.take, head.facts.controls, seek);
    this.bindIntensity();
    this.bindSearch(head.facts.controls);
    for (const region of new Set<string>(head.facts.regions)) this.addRegion(region);
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
    if (take.intensity) parts.push(`intensity ${take.intensityAt(frame).toFixed(2)}`);
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

  private bindSearch(controls: string[]): void {
    for (const value of controls) $("names").append(Object.assign(document.createElement("option"), { value }));
    const search = $<HTMLInputElement>("search");
    search.addEventListener("change", () => { if (this.lanes.add(search.value)) search.value = ""; });
  }

  private addRegion(region: string): void {
    const { takes } = this;
    const made = button(region, () => {
      for (const take of takes) if (!take.muted.delete(region)) take.muted.add(region);
      this.showMuted();
    });
    made.title = "Click mutes; double click mutes all other regions";
    made.setAttribute("aria-pressed", "true");
    made.addEventListener("dblclick", () => {
      const others = this.regions.map((b) => b.textContent!).filter((name) => name !== region);
      for (const take of takes) {
        take.muted.clear();
        others.forEach((name) => take.muted.add(name));
      }
      this.showMuted();
    });
    $("regions").append(made);
  }

  private get regions(): HTMLButtonElement[] {
    return [...document.querySelectorAll<HTMLButtonElement>("#regions button")];
  }

  private showMuted(): void {
    for (const b of this.regions) b.setAttribute("aria-pressed", String(!this.take.muted.has(b.textContent!)));
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
