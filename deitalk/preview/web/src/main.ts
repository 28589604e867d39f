/** The preview page: one clock drives the faces of takes, an opened GLB, timeline and curves. */

import "./style.css";

import { Clock } from "./clock";
import { base64Bytes, unpack, type Packed } from "./data";
import { Face } from "./face";
import { Opener } from "./opener";
import { $, button, notice } from "./page";
import { Take } from "./take";
import { samplesOf, SoundView } from "./timeline";
import { Transport } from "./transport";
import { Workbench } from "./workbench";

const VIEWS: [string, string, string][] = [
  ["1", "face", "Face"], ["2", "three_quarter", "Three quarter"], ["3", "side", "Side"], ["4", "mouth", "Mouth"],
];
const FPS_WITHOUT_TAKE = 30;

/** Data of the page, from `deitalk.preview.page`. */
interface Contents {
  head: Packed;
  takes: Take[];
  wav: Uint8Array | null;
  audioSeconds: number;
}

class Page {
  private readonly faces: Face[] = [];
  private readonly takes: Take[];
  private readonly clock: Clock;
  private readonly sound: SoundView;
  private readonly opener: Opener;
  private readonly transport: Transport;
  private readonly workbench?: Workbench;

  constructor(contents?: Contents) {
    this.takes = contents?.takes ?? [];
    const [first] = this.takes, wav = contents?.wav ?? null;
    this.clock = new Clock(wav, first?.seconds ?? 0);
    const share = first && contents?.audioSeconds ? Math.min(contents.audioSeconds / first.seconds, 1) : 0;
    this.sound = new SoundView($<HTMLCanvasElement>("sound"), wav ? samplesOf(wav) : new Int16Array(0), share);
    for (const take of this.takes) this.addFace(contents!.head, take);
    this.opener = new Opener(() => this.opened());
    const keys = Object.fromEntries(VIEWS.map(([key, view]) => [key, () => this.look(view)]));
    this.transport = new Transport(this.clock, first?.fps ?? FPS_WITHOUT_TAKE, (s) => this.draw(s), {
      ...keys, o: () => $("open").click(),
    });
    $("views").prepend(...VIEWS.map(([key, view, label]) => button(`${label} (${key})`, () => this.look(view))));
    $("workbench").hidden = !contents;
    if (contents) {
      $("title").textContent = this.takes.map((take) => take.title).join(" | ");
      this.workbench = new Workbench(
        contents.head, this.takes, contents.audioSeconds,
        (s) => this.seek(s), () => this.transport.show(this.transport.shown),
      );
    }
    addEventListener("resize", () => this.layout());
    this.layout();
    Object.assign(window, { deitalk: { page: this, ready: true } });
  }

  /** State for tests: time, frame and vertices as shown. */
  state() {
    const { shown, time } = this.transport, { model } = this.opener;
    return { time, shown, frame: Math.round(shown * (this.takes[0]?.fps ?? FPS_WITHOUT_TAKE)),
      vertices: this.faces[0]?.rig.vertices, model: model && { seconds: model.seconds, vertices: model.vertices() } };
  }

  pose(values: ArrayLike<number>): Float32Array {
    return this.faces[0].rig.pose(values);
  }

  seek(seconds: number): void {
    this.transport.seek(seconds);
  }

  look(view: string): void {
    this.faces.forEach((face) => face.look(view));
    this.opener.model?.look(view);
  }

  private addFace(head: Packed, take: Take): void {
    const face = new Face(head);
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.textContent = take.title + (this.takes.length > 1 && !this.faces.length ? " (timeline)" : "");
    face.canvas.setAttribute("role", "img");
    face.canvas.setAttribute("aria-label", `Face of ${take.title}; drag to turn`);
    figure.append(face.canvas, caption);
    $("faces").append(figure);
    this.faces.push(face);
  }

  /** Update after a GLB is opened or closed; without a take the GLB gives the duration. */
  private opened(): void {
    const { model } = this.opener;
    if (!this.takes.length) this.clock.seconds = model?.seconds ?? 0;
    this.layout();
    model?.look("face");
  }

  private draw(seconds: number): void {
    const late = Number($<HTMLInputElement>("offset").value) / 1000;
    this.faces.forEach((face, k) => face.show(this.takes[k].at(seconds + late)));
    this.opener.model?.show(seconds + late);
    this.sound.at(this.clock.seconds ? Math.min(seconds / this.clock.seconds, 1) : 0);
    this.workbench?.at(seconds);
  }

  private layout(): void {
    this.faces.forEach((face) => face.resize());
    this.opener.model?.resize();
    this.workbench?.layout();
    this.transport.show(Math.min(this.transport.shown, this.clock.seconds));
  }
}

const text = (id: string) => $(id)?.textContent ?? "";

async function start(): Promise<void> {
  if (!text("head")) {
    notice("No take in this page: drop a GLB here, or make one with: deitalk preview take/ -o preview.html");
    new Page();
    return;
  }
  const head = await unpack(text("head"));
  const packed = [await unpack(text("take-0"))];
  if ($("take-1")) packed.push(await unpack(text("take-1")));
  const takes = packed.map((p) => new Take(p, head.facts));
  const wav = text("audio-0") ? base64Bytes(text("audio-0")) : null;
  new Page({ head, takes, wav, audioSeconds: packed[0].facts.audioSeconds });
}

start().catch((error) => {
  notice(`The page could not start: ${error.message ?? error}`);
  console.error(error);
});
