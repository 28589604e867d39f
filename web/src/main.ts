/** The preview page: one clock drives faces, timeline and curves. */

import "./style.css";

import { Clock } from "./clock";
import { CurveLanes } from "./curves";
import { base64Bytes, unpack, type Packed } from "./data";
import { Face } from "./face";
import { Take } from "./take";
import { drawEmotion, IntensityEditor, samplesOf, SoundView } from "./timeline";

const $ = <T extends Element = HTMLElement>(id: string) => document.getElementById(id) as unknown as T;
const text = (id: string) => $(id)?.textContent ?? "";

const VIEW_KEYS: [string, string, string][] = [
  ["1", "face", "Face"], ["2", "three_quarter", "Three quarter"], ["3", "side", "Side"], ["4", "mouth", "Mouth"],
];
const KEYS: [string, string][] = [
  ["Space", "play or pause"], [", .", "one frame back, on"], ["Home", "to the start"], ["L", "loop"],
  ["- +", "slower, faster"], ["1 2 3 4", "face, three quarter, side, mouth"], ["?", "this list"],
  ["↑ ↓", "move the intensity point in focus"],
];

class Page {
  private readonly faces: Face[] = [];
  private readonly clock: Clock;
  private readonly sound: SoundView;
  private readonly editor: IntensityEditor;
  private readonly lanes: CurveLanes;
  private shown = NaN;
  private stale = 0;

  constructor(head: Packed, private readonly takes: Take[], wav: Uint8Array | null, audioSeconds: number) {
    const take = takes[0];
    this.clock = new Clock(wav, take.seconds);
    const share = audioSeconds ? Math.min(audioSeconds / take.seconds, 1) : 0;
    const samples = wav ? samplesOf(wav) : new Int16Array(0);
    this.sound = new SoundView($<HTMLCanvasElement>("sound"), samples, share);
    for (const each of takes) this.addFace(head, each);
    this.editor = new IntensityEditor($<SVGSVGElement>("intensity"), take, () => this.edited());
    this.lanes = new CurveLanes($("curves"), take, head.facts.controls, (s) => this.seek(s));
    $("title").textContent = takes.map((t) => t.title).join(" | ");
    this.bindPlayback();
    this.bindViews();
    this.bindEditing(head);
    this.listWarnings(audioSeconds);
    addEventListener("resize", () => this.layout());
    this.layout();
    this.loop();
    Object.assign(window, { deitalk: { page: this, ready: true } });
  }

  /** For tests and for the curious: time, frame and vertices as shown. */
  state() {
    return { time: this.clock.time, shown: this.shown, frame: Math.round(this.shown * this.takes[0].fps),
      vertices: this.faces[0].rig.vertices };
  }

  pose(values: ArrayLike<number>): Float32Array {
    return this.faces[0].rig.pose(values);
  }

  private addFace(head: Packed, take: Take): void {
    const face = new Face(head);
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.textContent = take.title;
    face.canvas.setAttribute("role", "img");
    face.canvas.setAttribute("aria-label", `Face of ${take.title}; drag to turn`);
    figure.append(face.canvas, caption);
    $("faces").append(figure);
    this.faces.push(face);
  }

  private get offset(): number {
    return Number($<HTMLInputElement>("offset").value) / 1000;
  }

  seek(seconds: number): void {
    this.clock.seek(seconds);
    this.show(seconds);
  }

  step(frames: number): void {
    this.clock.pause();
    const fps = this.takes[0].fps;
    this.seek((Math.round(this.clock.time * fps) + frames) / fps);
    this.labelPlay();
  }

  async toggle(): Promise<void> {
    if (this.clock.playing) this.clock.pause();
    else await this.clock.play();
    this.labelPlay();
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
    if (clock.time >= this.takes[0].seconds - 0.001 || clock.audio?.ended) this.atEnd();
    requestAnimationFrame(this.loop);
  };

  /** Seconds that drawing a frame takes; the frame shown is the one due when it is drawn. */
  private lead = 0;

  private showAhead(): void {
    const began = performance.now();
    this.show(Math.min(this.clock.time + this.lead * this.clock.rate, this.takes[0].seconds));
    setTimeout(() => {
      const took = Math.min((performance.now() - began) / 1000, 0.1);
      this.lead += 0.2 * (took - this.lead);
    }, 0);
  }

  private atEnd(): void {
    if ($<HTMLInputElement>("loop").checked && this.shown > 0) void this.clock.play();
    else if (this.clock.playing) this.clock.pause();
    if ($("play").textContent === "Pause" && !this.clock.playing) this.labelPlay();
  }

  private show(seconds: number): void {
    const take = this.takes[0];
    this.shown = seconds;
    this.faces.forEach((face, k) => face.show(this.takes[k].at(seconds + this.offset)));
    const share = Math.min(seconds / take.seconds, 1);
    const frame = Math.min(Math.round(seconds * take.fps), take.frames - 1);
    $("clock").textContent = `${timeCode(seconds)}  frame ${frame}`;
    const sound = $<HTMLCanvasElement>("sound");
    this.sound.at(share);
    sound.setAttribute("aria-valuenow", seconds.toFixed(2));
    sound.setAttribute("aria-valuemax", take.seconds.toFixed(2));
    this.editor.at(share);
    this.lanes.at(seconds);
    $("status").textContent = this.words(frame);
  }

  private words(frame: number): string {
    const take = this.takes[0], parts: string[] = [];
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
    this.show(this.shown || 0);
    clearTimeout(this.stale);
    this.stale = window.setTimeout(() => this.lanes.build(), 250);
  }

  private bindPlayback(): void {
    $("play").addEventListener("click", () => void this.toggle());
    $("back").addEventListener("click", () => this.step(-1));
    $("next").addEventListener("click", () => this.step(1));
    $<HTMLSelectElement>("speed").addEventListener("change", (e) =>
      this.clock.setRate(Number((e.target as HTMLSelectElement).value)));
    $("offset").addEventListener("input", () => this.show(this.clock.time));
    const sound = $<HTMLCanvasElement>("sound");
    const scrub = (e: PointerEvent) => {
      const box = sound.getBoundingClientRect();
      this.seek(((e.clientX - box.left) / box.width) * this.takes[0].seconds);
    };
    sound.addEventListener("pointerdown", (e) => { sound.setPointerCapture(e.pointerId); scrub(e); });
    sound.addEventListener("pointermove", (e) => { if (sound.hasPointerCapture(e.pointerId)) scrub(e); });
    addEventListener("keydown", (e) => this.key(e));
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

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (/^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName) || event.ctrlKey || event.metaKey) return;
    if (event.key === " " && target.tagName === "BUTTON") return;
    const speed = $<HTMLSelectElement>("speed");
    const change = (by: number) => {
      speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
      this.clock.setRate(Number(speed.value));
    };
    const actions: Record<string, () => void> = {
      " ": () => void this.toggle(), ",": () => this.step(-1), ".": () => this.step(1),
      ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1), Home: () => this.seek(0),
      l: () => $("loop").click(), "-": () => change(-1), "+": () => change(1), "?": () => $("help-button").click(),
      ...Object.fromEntries(VIEW_KEYS.map(([key, view]) => [key, () => this.look(view)])),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  look(view: string): void {
    this.faces.forEach((face) => face.look(view));
  }

  private bindViews(): void {
    for (const [key, view, label] of VIEW_KEYS) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `${label} (${key})`;
      button.addEventListener("click", () => this.look(view));
      $("views").append(button);
    }
  }

  private bindEditing(head: Packed): void {
    const take = this.takes[0];
    $("reset").addEventListener("click", () => { take.reset(); this.editor.build(); this.edited(); });
    $("save").addEventListener("click", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([take.csv()], { type: "text/csv" }));
      link.download = "intensity.csv";
      link.click();
    });
    for (const id of ["reset", "save"]) $<HTMLButtonElement>(id).disabled = !take.isEditable;
    for (const name of head.facts.controls as string[]) {
      const option = document.createElement("option");
      option.value = name;
      $("names").append(option);
    }
    const search = $<HTMLInputElement>("search");
    search.addEventListener("change", () => { if (this.lanes.add(search.value)) search.value = ""; });
    for (const region of new Set(head.facts.regions as string[])) this.addRegion(region);
  }

  private addRegion(region: string): void {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = region;
    button.title = "Click mutes; double click leaves this region alone";
    button.setAttribute("aria-pressed", "true");
    const refresh = () => {
      document.querySelectorAll<HTMLButtonElement>("#regions button").forEach((b) =>
        b.setAttribute("aria-pressed", String(!this.takes[0].muted.has(b.textContent!))));
      this.edited();
    };
    button.addEventListener("click", () => {
      for (const take of this.takes) if (!take.muted.delete(region)) take.muted.add(region);
      refresh();
    });
    button.addEventListener("dblclick", () => {
      const all = [...document.querySelectorAll("#regions button")].map((b) => b.textContent!);
      for (const take of this.takes) {
        take.muted.clear();
        all.filter((name) => name !== region).forEach((name) => take.muted.add(name));
      }
      refresh();
    });
    $("regions").append(button);
  }

  private listWarnings(audioSeconds: number): void {
    const take = this.takes[0];
    const found = take.warnings(audioSeconds);
    const list = $("warnings");
    if (!found.length) list.append(Object.assign(document.createElement("li"), { textContent: "none" }));
    for (const { time, text } of found) {
      const item = document.createElement("li"), go = document.createElement("button");
      go.type = "button";
      go.textContent = timeCode(time);
      go.addEventListener("click", () => this.seek(time));
      item.append(go, ` ${text}`);
      list.append(item);
    }
  }

  private layout(): void {
    this.faces.forEach((face) => face.resize());
    drawEmotion($<HTMLCanvasElement>("emotion"), this.takes[0]);
    this.editor.layout();
    this.lanes.resize();
    this.show(Number.isNaN(this.shown) ? 0 : this.shown);
  }
}

function timeCode(seconds: number): string {
  const minutes = Math.floor(seconds / 60);
  return `${String(minutes).padStart(2, "0")}:${(seconds - 60 * minutes).toFixed(3).padStart(6, "0")}`;
}

async function start(): Promise<void> {
  if (!text("head")) {
    $("status").textContent = "This page has no take in it; make one with: deitalk preview take/ -o preview.html";
    return;
  }
  const head = await unpack(text("head"));
  const packed = [await unpack(text("take-0"))];
  if ($("take-1")) packed.push(await unpack(text("take-1")));
  const takes = packed.map((p) => new Take(p, head.facts));
  const wav = text("audio-0") ? base64Bytes(text("audio-0")) : null;
  new Page(head, takes, wav, packed[0].facts.audioSeconds);
}

start().catch((error) => {
  $("status").textContent = `The page could not start: ${error.message ?? error}`;
  console.error(error);
});
