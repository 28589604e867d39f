/** The timeline of a take: lanes on one span, edits with undo, regions, warnings. */

import type { History } from "../data/edit";
import type { Board } from "../data/board";
import type { Take } from "../data/take";
import { $, button, save, showValue, timeCode } from "../dom";
import { isText } from "../playback/keys";
import { CurveLanes } from "./curves";
import { EmotionLane } from "./emotion";
import { IntensityLane } from "./intensity";
import { LayerLane } from "./layers";
import { factorSlider, Regions } from "./regions";
import { bindSearch } from "./search";
import type { Span } from "./span";

const REBUILD_MS = 250;
const ZOOM_STEP = 0.7;
/** Parts of the idle motion that `deitalk animate --life` scales. */
const LIFE = ["brows", "head", "blinks", "gaze"];
/** Fields of what is said. */
const WORDS = ["words", "language"] as const;

export class Workbench {
  readonly emotion: EmotionLane;
  private readonly intensity: IntensityLane;
  private readonly lanes: CurveLanes;
  readonly layers: LayerLane;
  private readonly regions: Regions;
  private readonly life: (() => void)[];
  private take?: Take;
  private mean?: number;
  private stale = 0;

  constructor(
    board: Board,
    private readonly history: History,
    private readonly span: Span,
    private readonly time: () => number,
    private readonly seek: (seconds: number) => void,
  ) {
    this.emotion = new EmotionLane($<HTMLCanvasElement>("emotion"), $<SVGSVGElement>("keys"), span, history);
    this.intensity = new IntensityLane($<SVGSVGElement>("intensity"), span, history);
    this.lanes = new CurveLanes($("curves"), span, board.controls, seek);
    this.regions = new Regions($("regions"), [...new Set(board.regions)], history);
    this.layers = new LayerLane($<SVGSVGElement>("layer-lane"), span, board, history, (name) => this.lanes.add(name));
    this.life = LIFE.map((name) => this.lifeSlider(name));
    this.bindWords();
    bindSearch(board.controls, (name) => this.layers.choose(name));
    this.bindEdits();
    this.bindZoom();
  }

  /** Show a take; the curves of others are dashed. */
  show(take: Take, others: Take[]): void {
    this.take = take;
    this.intensity.show(take);
    this.emotion.show(take);
    this.layers.show(take);
    this.lanes.show([take, ...others]);
    this.listWarnings();
    this.edited();
  }

  /** Show the edit at once, and the curves when no more changes come. */
  edited(): void {
    const { history, take } = this;
    $<HTMLButtonElement>("undo").disabled = !history.canUndo;
    $<HTMLButtonElement>("redo").disabled = !history.canRedo;
    this.regions.show();
    this.life.forEach((show) => show());
    for (const name of WORDS) showValue($(name), history.edit[name] ?? "");
    if (!take) return;
    $<HTMLButtonElement>("add-edit").disabled = false;
    for (const id of ["add-point", "save"]) $<HTMLButtonElement>(id).disabled = !take.isEditable;
    $<HTMLButtonElement>("reset").disabled = !history.edit.points.length;
    this.mean = take.meanIntensity;
    this.intensity.scale();
    this.emotion.layout();
    this.layers.edited();
    clearTimeout(this.stale);
    this.stale = window.setTimeout(() => this.lanes.build(), REBUILD_MS);
  }

  at(seconds: number): void {
    this.intensity.at(seconds);
    this.layers.at(seconds);
    this.lanes.at(seconds);
    if (this.take) $("status").textContent = this.words(this.take, seconds);
  }

  layout(): void {
    this.intensity.layout();
    this.emotion.layout();
    this.layers.layout();
    this.lanes.resize();
  }

  private words(take: Take, seconds: number): string {
    const frame = Math.min(Math.round(seconds * take.fps), take.frames - 1), parts: string[] = [];
    const emotion = take.emotionAt(frame);
    if (emotion) parts.push(emotion);
    if (take.intensity && emotion !== "neutral") {
      const mean = this.mean === undefined ? "" : ` (mean over speech ${this.mean.toFixed(2)})`;
      parts.push(`intensity ${take.intensityAt(frame).toFixed(2)}${mean}`);
    }
    if (take.isBlend) parts.push("a blend of two readings: animate with the saved CSV applies every rule");
    return parts.join(", ");
  }

  private lifeSlider(name: string): () => void {
    const { slider, show } = factorSlider(`Motion of ${name}`, this.history, "life", name);
    const label = document.createElement("label");
    label.append(name, slider);
    $("life").append(label);
    show();
    return show;
  }

  /** What is said is taken when the field is left, or by Enter. */
  private bindWords(): void {
    for (const name of WORDS) {
      const field = $<HTMLInputElement>(name);
      field.addEventListener("change", () => this.history.change({ [name]: field.value.trim() }));
    }
  }

  private bindEdits(): void {
    const { history } = this;
    $("undo").addEventListener("click", () => history.undo());
    $("redo").addEventListener("click", () => history.redo());
    addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.altKey || isText(event.target as HTMLElement)) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      if (key === "y" || event.shiftKey) history.redo();
      else history.undo();
    });
    $("reset").addEventListener("click", () => history.change({ points: [] }));
    $("add-point").addEventListener("click", () => this.intensity.addAt(this.time()));
    $("add-key").addEventListener("click", () => this.emotion.addAt(this.time()));
    $("add-edit").addEventListener("click", () => this.layers.addAt(this.time()));
    $("save").addEventListener("click", () => {
      if (this.take) save(new Blob([this.take.intensityCsv()], { type: "text/csv" }), "intensity.csv");
    });
  }

  private bindZoom(): void {
    const { span } = this;
    $("zoom-in").addEventListener("click", () => span.zoom(ZOOM_STEP, this.time()));
    $("zoom-out").addEventListener("click", () => span.zoom(1 / ZOOM_STEP, this.time()));
    $("zoom-fit").addEventListener("click", () => span.fit());
    $("timeline").addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      const box = $("sound").getBoundingClientRect();
      const by = event.deltaY || event.deltaX;
      if (event.ctrlKey) span.zoom(Math.exp(by / 400), span.time(event.clientX - box.left, box.width));
      else span.pan((by / box.width) * span.seconds);
    }, { passive: false });
  }

  private listWarnings(): void {
    const list = $("warnings"), found = this.take!.warnings;
    list.replaceChildren(...found.map(({ time, text }) => {
      const item = document.createElement("li");
      item.append(button(timeCode(time), () => this.seek(time)), ` ${text}`);
      return item;
    }));
    if (!found.length) list.append(Object.assign(document.createElement("li"), { textContent: "none" }));
  }
}
