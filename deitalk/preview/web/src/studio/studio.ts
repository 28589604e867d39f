/** The studio: a recording and edits become takes and files through the service. */

import { type Edit, NO_EDIT } from "../data/edit";
import { type Packed, unpackBytes } from "../data/packed";
import { Take } from "../data/take";
import { $, button, messageOf, notice, save } from "../dom";
import type { Player } from "../player";
import { COLORS } from "../timeline/emotion";
import { wavOf } from "./wav";
import { bindMicrophone } from "./microphone";
import { convert, emotionCsv, order, type Order, type Result } from "./service";
import { latestSession, loadSession, saveSession, type Session } from "./session";
import { Work } from "./work";

const EMOTIONS = ["neutral", "angry", "happy", "sad", "surprised"];
/** Kinds of files: label, format of the service, whether it takes long enough for a job. */
const EXPORTS: [string, string, boolean][] = [
  ["CSV", "csv", false], ["JSON", "json", false], ["Live Link", "livelink", false], ["GLB", "glb", false],
  ["Video", "mp4", true], ["Page", "page", false], ["Take", "take", false],
];
const SETTLE_MS = 350;
const SAVE_MS = 200;
/** Longer recordings are not animated again after every edit; exports are exact all the same. */
const LIVE_SECONDS = 60;

export class Studio {
  private session?: Session;
  private readonly animating = new Work();
  private readonly exporting = new Work();
  private settling = 0;
  private saving = 0;
  /** The keys of the shown take. */
  private animated?: Edit["keys"];

  constructor(private readonly player: Player) {
    document.body.classList.add("studio");
    player.workbench!.emotion.isEditable = true;
    player.workbench!.emotion.onSelect = () => this.showEmotion();
    player.history.reset({ ...NO_EDIT, keys: [{ time: 0, emotion: "neutral", strength: 1 }] });
    player.onEdit = () => this.edited();
    player.convert = convert;
    addEventListener("pagehide", () => this.save());
    player.intake.recording = (file) => this.open(file);
    player.onTake = ({ wav, emotion }) => void this.adopt(wav, emotion);
    $("pick").addEventListener("click", () => $("file").click());
    bindMicrophone((file) => this.open(file));
    $("emotions").append(...EMOTIONS.map((name) => this.emotionButton(name)));
    $("exports").append(
      ...EXPORTS.map(([label, format, isLong]) => button(label, () => void this.export(format, isLong))),
      button("Edits", () => this.exportEdits()),
    );
    $("compare").addEventListener("click", () => void this.compare());
    $("keep").addEventListener("click", () => this.setOther(player.take!.frozen("A")));
    $("drop-other").addEventListener("click", () => this.setOther());
    this.enable();
  }

  /** Continue with the session of this tab; without one, offer the latest. */
  async restore(): Promise<void> {
    try {
      const session = await loadSession();
      if (session) return await this.resume(session);
      const latest = await latestSession();
      if (latest) $("hint").append(button(`Continue with ${latest.name}`, () => void this.continue(latest.id)));
    } catch (error) {
      notice(`the last session cannot be read: ${messageOf(error)}`);
    }
  }

  private async continue(id: string): Promise<void> {
    const session = await loadSession(id);
    if (session) await this.resume(session);
  }

  private async resume(session: Session): Promise<void> {
    const { take, wav } = await this.unpacked(session.packed);
    this.session = session;
    this.animated = session.edit.keys;
    this.player.load(take, wav, [], session.edit);
    this.player.transport.setRange(session.range);
    this.player.seek(session.time);
    this.enable();
  }

  /** Whether the shown take has the keys of the edits, and nothing is on its way. */
  get isSettled(): boolean {
    return !this.animating.isBusy && this.session?.edit.keys === this.animated;
  }

  /** Begin anew with a recording, in the emotion that was chosen. */
  async open(file: File): Promise<void> {
    const keys = [{ time: 0, emotion: this.player.history.edit.keys[0]?.emotion ?? "neutral", strength: 1 }];
    const edit: Edit = { ...NO_EDIT, keys };
    const packed = await this.animate(file, edit, file.name);
    if (!packed) return;
    this.session = { name: file.name, recording: file, edit, packed, time: 0 };
    const { take, wav } = await this.unpacked(packed);
    this.leaveGallery();
    this.animated = keys;
    this.player.load(take, wav, [], edit);
    this.enable();
    this.player.transport.play();
  }

  private animate(recording: Blob, edit: Edit, name: string, intensityCsv?: string): Promise<Blob | undefined> {
    const given: Order = { recording, edit, name, intensityCsv, format: "packed" };
    return this.animating.run("Animating", async (progress, signal) => {
      const { content, notes } = await order(given, progress, signal);
      if (notes.length) notice(notes.join("; "));
      return content;
    });
  }

  /** A take that was dropped: its sound is the recording, its emotion the first key. */
  private async adopt(wav: Uint8Array | undefined, emotion: string): Promise<void> {
    this.session = undefined;
    this.leaveGallery();
    this.enable();
    const found = /^\s*([a-z]+)(?:=([0-9.]+))?\s*$/.exec(emotion);
    if (!wav || !found || !EMOTIONS.includes(found[1])) return;
    const file = new File([wav as BlobPart], this.player.take!.title, { type: "audio/wav" });
    const keys = [{ time: 0, emotion: found[1], strength: Number(found[2] ?? 1) }];
    const packed = await this.animate(file, { ...NO_EDIT, keys }, file.name);
    if (!packed) return;
    this.session = { name: file.name, recording: file, edit: { ...NO_EDIT, keys }, packed, time: 0 };
    this.animated = keys;
    this.player.history.reset({ ...NO_EDIT, keys });
    this.enable();
  }

  private emotionButton(name: string): HTMLButtonElement {
    const made = button(name, () => {
      this.leaveGallery();
      this.player.workbench!.emotion.choose(name, this.player.transport.shown);
    });
    made.style.setProperty("--emotion", COLORS[name]);
    return made;
  }

  /** After an edit: keep it, and animate again once no more edits come. */
  private edited(): void {
    const { session, player } = this;
    this.showEmotion();
    if (!session) return;
    session.edit = player.history.edit;
    this.keep();
    clearTimeout(this.settling);
    this.settling = window.setTimeout(() => void this.settle(), SETTLE_MS);
  }

  private async settle(): Promise<void> {
    const { session, player } = this, take = player.take;
    if (!session || !take || take.seconds > LIVE_SECONDS) return this.settleLong();
    const { edit } = session;
    if (edit.keys !== this.animated) await this.animateKeys(session, edit);
    if (edit === session.edit && player.take!.isBlend) await this.animatePoints(session, edit);
  }

  /** A long recording is animated again for its keys only. */
  private async settleLong(): Promise<void> {
    if (this.session && this.session.edit.keys !== this.animated) await this.animateKeys(this.session, this.session.edit);
  }

  private async animateKeys(session: Session, edit: Edit): Promise<void> {
    const packed = await this.animate(session.recording, edit, session.name);
    if (!packed || session.edit.keys !== edit.keys) return;
    session.packed = packed;
    this.animated = edit.keys;
    this.player.replace((await this.unpacked(packed)).take);
    this.keep();
  }

  private async animatePoints(session: Session, edit: Edit): Promise<void> {
    const { take } = this.player;
    const packed = await this.animate(session.recording, edit, session.name, take!.intensityCsv());
    if (!packed || take !== this.player.take) return;
    take!.setExact(edit.points, (await this.unpacked(packed)).take);
    this.player.replace(take!);
  }

  /** The five emotions side by side; a press on a name takes it. */
  private async compare(): Promise<void> {
    const { session, player } = this;
    if (!session || $("compare").getAttribute("aria-pressed") === "true") return this.leaveGallery();
    const takes = await this.animating.run("Animating five emotions", async (progress, signal) => {
      const found: Take[] = [];
      for (const emotion of EMOTIONS) {
        progress(found.length / EMOTIONS.length);
        const edit = { ...session.edit, keys: [{ time: 0, emotion, strength: 1 }] };
        const given = { recording: session.recording, edit, name: session.name, format: "packed" };
        found.push((await this.unpacked((await order(given, progress, signal)).content)).take);
      }
      return found;
    });
    if (!takes) return;
    const captions = EMOTIONS.map((title) => ({ title, choose: () => this.choose(title) }));
    player.setGallery(takes, captions);
    $("compare").setAttribute("aria-pressed", "true");
  }

  private choose(emotion: string): void {
    this.leaveGallery();
    this.player.history.change({ keys: [{ time: 0, emotion, strength: 1 }] });
  }

  /** Keep a version beside the take, or none. */
  private setOther(...others: Take[]): void {
    this.leaveGallery();
    this.player.setOthers(others);
    this.showEmotion();
  }

  private leaveGallery(): void {
    if ($("compare").getAttribute("aria-pressed") !== "true") return;
    $("compare").setAttribute("aria-pressed", "false");
    this.player.setGallery();
  }

  /** A file of the take with its edits, as the command line writes it. */
  private async export(format: string, isLong: boolean): Promise<void> {
    const { session, player } = this;
    if (!session) return;
    const intensityCsv = session.edit.points.length ? player.take!.intensityCsv() : undefined;
    const given = { recording: session.recording, edit: session.edit, name: session.name, intensityCsv, format, isLong };
    const result: Result | undefined = await this.exporting.run(`Exporting ${format}`, (progress, signal) => order(given, progress, signal));
    if (!result) return;
    save(result.content, result.fileName);
    notice([`saved ${result.fileName}`, ...result.notes].join("; "));
  }

  /** The edits as files for the command line, which is shown with them. */
  private exportEdits(): void {
    const { session, player } = this;
    if (!session) return;
    save(new Blob([emotionCsv(session.edit)], { type: "text/csv" }), "emotion.csv");
    const words = [`deitalk animate ${session.name} --emotion emotion.csv`];
    if (session.edit.points.length) {
      save(new Blob([player.take!.intensityCsv()], { type: "text/csv" }), "intensity.csv");
      words.push("--intensity-curve intensity.csv");
    }
    notice(`${words.join(" ")} -o take/`);
  }

  private async unpacked(packed: Blob): Promise<{ take: Take; wav: Uint8Array | null }> {
    const found: Packed = await unpackBytes(packed);
    const { audio } = found.arrays, { sampleRate } = found.facts;
    const wav = audio && sampleRate ? wavOf(audio as Int16Array, sampleRate) : null;
    return { take: new Take(found, this.player.board), wav };
  }

  /** Save the session once no more changes come. */
  private keep(): void {
    clearTimeout(this.saving);
    this.saving = window.setTimeout(() => this.save(), SAVE_MS);
  }

  private save(): void {
    const { session, player } = this;
    if (!session) return;
    Object.assign(session, { range: player.transport.range, time: player.transport.shown });
    saveSession(session).catch((error) => notice(`the session cannot be kept: ${messageOf(error)}`));
  }

  private enable(): void {
    const isOn = this.session !== undefined;
    for (const b of document.querySelectorAll<HTMLButtonElement>("#exports button, #compare, #keep, #add-key")) {
      b.disabled = !isOn;
    }
    this.showEmotion();
    this.keep();
  }

  private showEmotion(): void {
    const shown = this.player.workbench!.emotion.emotionAt(this.player.transport.shown);
    for (const b of document.querySelectorAll("#emotions button")) b.setAttribute("aria-pressed", String(b.textContent === shown));
    $("drop-other").hidden = this.player.takes.length < 2;
  }
}
