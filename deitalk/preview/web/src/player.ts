/** The page: one clock drives the faces of takes, an opened GLB, and the lanes of the timeline. */

import { filesOfZip, readCurves, readTake, type TakeFiles } from "./data/curvefile";
import { type Edit, History, NO_EDIT } from "./data/edit";
import { parseLayers } from "./data/layers";
import type { Packed } from "./data/packed";
import type { Board } from "./data/board";
import { Take } from "./data/take";
import { $, button } from "./dom";
import { type Caption, Faces } from "./face/faces";
import { Opener } from "./face/opener";
import { bindIntake, type Intake } from "./intake";
import { Clock } from "./playback/clock";
import { Transport } from "./playback/transport";
import { SoundView } from "./timeline/sound";
import { Span } from "./timeline/span";
import { Workbench } from "./timeline/workbench";

const VIEWS: [string, string, string][] = [
  ["1", "face", "Face"], ["2", "three_quarter", "Three quarter"], ["3", "side", "Side"], ["4", "mouth", "Mouth"],
];

export class Player {
  /** The take of the timeline, and others beside it. */
  takes: Take[] = [];
  readonly history = new History(NO_EDIT, () => this.edited());
  readonly span = new Span(() => this.layout());
  readonly clock = new Clock();
  readonly transport: Transport;
  readonly opener = new Opener(() => this.opened());
  readonly workbench?: Workbench;
  readonly intake: Intake;
  /** Called after every edit. */
  onEdit: () => void = () => {};
  /** Converts curves that the page cannot read itself. */
  convert?: (file: File) => Promise<File>;
  /** Called with a take that was dropped. */
  onTake: (take: TakeFiles) => void = () => {};
  /** The file of the second take, if it was dropped. */
  otherFile?: File;
  /** Controls that are shown before any take. */
  first?: Float32Array;
  private readonly faces?: Faces;
  private readonly sound: SoundView;
  private live?: { values: Float32Array; head?: Float32Array };
  private gallery?: { takes: Take[]; captions: Caption[] };

  constructor(readonly head?: Packed) {
    this.sound = new SoundView($<HTMLCanvasElement>("sound"), this.span, () => this.transport?.range);
    const keys = Object.fromEntries(VIEWS.map(([key, view]) => [key, () => this.look(view)]));
    if (head) {
      this.faces = new Faces($("faces"), head);
      this.workbench = new Workbench(
        head.facts as Board, this.history, this.span, () => this.transport.shown, (s) => this.seek(s),
      );
    }
    this.transport = new Transport(this.clock, this.span, (s) => this.draw(s), { ...keys, o: () => $("open").click() });
    $("views").prepend(...VIEWS.map(([key, view, label]) => button(`${label} (${key})`, () => this.look(view))));
    $("workbench").hidden = true;
    if (head && !document.querySelector("#take-0")) this.faces!.set([{ title: "at rest" }]);
    this.intake = this.makeIntake();
    bindIntake(this.intake);
    new ResizeObserver(() => this.layout()).observe($("sound"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layout());
  }

  get take(): Take | undefined {
    return this.takes[0];
  }

  get board(): Board {
    return this.head!.facts as Board;
  }

  /** State for tests: time, frame and vertices as shown. */
  state() {
    const { shown, time, fps } = this.transport, { model } = this.opener;
    return { time, shown, frame: Math.round(shown * fps),
      vertices: this.faces?.rig?.vertices, model: model && { seconds: model.seconds, vertices: model.vertices() } };
  }

  pose(values: ArrayLike<number>): Float32Array {
    return this.faces!.rig!.pose(values);
  }

  /** Begin with a take, its recording, and others to compare it with. */
  load(take: Take, wav: Uint8Array | null, others: Take[] = [], edit: Edit = NO_EDIT): void {
    this.takes = [take, ...others];
    this.otherFile = undefined;
    this.transport.fps = take.fps;
    this.transport.range = undefined;
    this.setSound(wav, take.seconds);
    $("workbench").hidden = false;
    $("hint").hidden = true;
    this.history.reset(edit);
    this.show();
    this.transport.setRange();
    this.seek(0);
  }

  /** Another reading of the same recording, with the same edits; it may last longer, and its sound. */
  replace(take: Take, wav: Uint8Array | null): void {
    const { shown } = this.transport, isAsLong = take.seconds === this.take?.seconds;
    this.takes = [take, ...this.takes.slice(1)];
    if (!isAsLong) this.setSound(wav, take.seconds);
    this.apply();
    this.show();
    if (!isAsLong) this.seek(shown);
  }

  /** Takes beside the first: a version kept, a captured reference, which is of a file. */
  setOthers(others: Take[], file?: File): void {
    this.otherFile = file;
    this.takes = [...this.takes.slice(0, 1), ...others];
    this.apply();
    this.show();
  }

  /** Show these faces instead of those of the timeline. */
  setGallery(takes?: Take[], captions: Caption[] = []): void {
    this.gallery = takes && { takes, captions };
    this.apply();
    this.show();
  }

  /** Show controls that come from elsewhere, until none are given. */
  showLive(values?: Float32Array, head?: Float32Array): void {
    const isSame = !this.live === !values;
    this.live = values && { values, head };
    if (!isSame) this.showFaces();
    if (values || !isSame) this.transport.show(this.transport.shown);
  }

  seek(seconds: number): void {
    this.transport.seek(seconds);
  }

  look(view: string): void {
    this.faces?.look(view);
    this.opener.model?.look(view);
  }

  layout(): void {
    this.faces?.resize();
    this.opener.model?.resize();
    this.workbench?.layout();
    this.transport?.show(Math.min(this.transport.shown, this.clock.seconds));
  }

  private setSound(wav: Uint8Array | null, seconds: number): void {
    this.transport.pause();
    this.clock.load(wav, seconds);
    this.sound.load(wav);
    this.span.reset(seconds);
  }

  private get faceTakes(): Take[] {
    return this.gallery?.takes ?? this.takes;
  }

  private show(): void {
    const { takes } = this, [first] = takes;
    this.showFaces();
    $("title").textContent = takes.map((take) => take.title).join(" | ");
    $("drop-other").hidden = takes.length < 2;
    $("other-changes").hidden = !this.otherFile;
    this.workbench?.show(first, takes.slice(1));
    this.layout();
  }

  private showFaces(): void {
    const { takes, gallery } = this;
    const own = takes.map(({ title }, k) => ({ title: title + (takes.length > 1 && !k ? " (timeline)" : "") }));
    const shown = this.live || !takes.length ? [{ title: this.live ? "live" : "at rest" }] : gallery?.captions ?? own;
    this.faces?.set(shown);
    this.faces?.resize();
  }

  private apply(): void {
    const { edit } = this.history;
    this.take?.apply(edit);
    this.gallery?.takes.forEach((take) => take.apply(edit));
    this.takes.slice(1).forEach((take) => take.apply({ ...edit, points: [] }));
  }

  private edited(): void {
    this.apply();
    this.workbench?.edited();
    this.transport.show(this.transport.shown);
    this.onEdit();
  }

  /** Update after a GLB is opened or closed; without a take the GLB gives the duration. */
  private opened(): void {
    const { model } = this.opener;
    if (!this.take) this.setSound(null, model?.seconds ?? 0);
    this.layout();
    model?.look("face");
  }

  private draw(seconds: number): void {
    const late = Number($<HTMLInputElement>("offset").value) / 1000;
    const takes = this.faceTakes;
    if (this.live) this.faces?.show([this.live.values], [this.live.head]);
    else if (this.take) this.faces?.show(takes.map((t) => t.at(seconds + late)), takes.map((t) => t.headAt(seconds + late)));
    else if (this.head) this.faces?.show([this.first ?? Float32Array.from(this.board.rest)]);
    this.opener.model?.show(seconds + late);
    this.sound.at(seconds);
    this.workbench?.at(seconds);
  }

  private makeIntake(): Intake {
    const needHead = () => {
      if (!this.head) throw new Error("this page has no head; use deitalk serve --open, or deitalk preview");
    };
    const take = async (files: Map<string, Uint8Array>, name: string) => {
      needHead();
      const read = await readTake(files, name, this.board);
      this.load(new Take(read.packed, this.board), read.wav ?? null);
      this.onTake(read);
    };
    return {
      layers: (text, name) => {
        if (!this.take) throw new Error("open a take first; layers of edits change it");
        this.history.change({ layers: [...this.history.edit.layers, ...parseLayers(text, name)] });
      },
      glb: (file) => void this.opener.open(file),
      take,
      archive: async (file) => take(await filesOfZip(await file.arrayBuffer()), file.name.replace(/\.zip$/i, "")),
      curves: async (file) => {
        needHead();
        const curves = await readCurves(file, this.board).catch(async (error) => {
          if (!this.convert) throw error;
          return readCurves(await this.convert(file), this.board);
        });
        if (this.take) this.setOthers([new Take(curves, this.board, true)], file);
        else this.load(new Take(curves, this.board), null);
      },
    };
  }
}
