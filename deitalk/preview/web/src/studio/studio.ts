/** The studio: a recording and edits become takes and files through the service. */

import type { TakeFiles } from "../data/curvefile";
import { type Edit, gainsOf, NO_EDIT } from "../data/edit";
import { layersText, parseLayers } from "../data/layers";
import { unpackBytes } from "../data/packed";
import { Take } from "../data/take";
import { $, button, messageOf, notice, save } from "../dom";
import type { Player } from "../player";
import { COLORS, MOODS } from "../timeline/emotion";
import { wavOf } from "./wav";
import { bindForm, FIELDS } from "./form";
import { Live } from "./live";
import { SocketVoice } from "./socket";
import { bindMicrophone } from "./microphone";
import { convert, diff, emotionCsv, optionOf, optionsOf, order, type Order, type Progress, quoted, request, type Source } from "./service";
import { keepView, latestSession, loadSession, saveSession, type Session, sessionOf, type View } from "./session";
import { Work } from "./work";

const LABELS = Object.keys(COLORS), EMOTIONS = LABELS.filter((name) => !MOODS.includes(name));
/** Emotion of the sample, and the face before a recording. */
const FIRST = "happy";
const SMILE = { "mouth_cornerPull.ty": 0.55, "mouth_dimple.ty": 0.2, "eye_cheekRaise.ty": 0.5, "eye_squintInner.ty": 0.2, "brow_raiseOut.ty": 0.12 };
/** Begin of the note on a suggested emotion. */
const SUGGESTED = "suggested from the voice: ";
/** In the message of a service that suggests no emotion. */
const NO_AUTO = "emotion auto need torch";
/** Kinds of files: label, format of the service, whether it takes long enough for a job. */
const EXPORTS: [string, string, boolean][] = [
  ["CSV", "csv", false], ["JSON", "json", false], ["Live Link", "livelink", false], ["GLB", "glb", false],
  ["Video", "mp4", true], ["Page", "page", false], ["Take", "take", false],
];
/** Fields that the tracks and the sound of a dropped take hold, and factors. */
const OWN = ["emotion", "intensity", "intensity_curve", "listen", "gain", "life", "edit"];
/** Fields that are files on the command line; a dropped take keeps their content. */
const KEPT = ["voice", "after", "into"];
/** Arguments of a dropped take that its edit shows. */
const SHOWN = Object.keys(FIELDS).filter((name) => !OWN.includes(name));
/** Pause after the last edit until the take is animated again; of a recording that is a job of the service. */
const SETTLE_MS = 350, JOB_SETTLE_MS = 1500;
const SAVE_MS = 200;
const JOB_SECONDS = 60;

/** Whether two edits need the same curves of the network. */
const isSameReading = (a: Edit, b: Edit) =>
  a.keys === b.keys && a.life === b.life && a.words === b.words && a.language === b.language && a.acting === b.acting;

/** How files are written: fields beside the exports that are not 0. */
function shiftOf(): Record<string, string> {
  const fields = ["delay", "handles"].map((name) => [name, $<HTMLInputElement>(name).value.trim()]);
  return Object.fromEntries(fields.filter(([, value]) => Number(value)));
}

/** Give each file that is chosen in a field to an action. */
function onFile(id: string, action: (file: File) => void): void {
  const field = $<HTMLInputElement>(id);
  field.addEventListener("change", () => {
    const [file] = field.files ?? [];
    field.value = "";
    if (file) action(file);
  });
}

/** A take as the service packed it. */
interface Reading {
  packed: Blob;
  take: Take;
  wav: Uint8Array | null;
  notes: string[];
}

/** Factors by name, such as `jaw=1.2,brow=.8`; undefined for other text. */
function factorsOf(given: unknown): Record<string, number> | undefined {
  const pairs = typeof given === "string" ? given.split(",").map((part) => part.split("=")) : Object.entries(given ?? {});
  const factors = Object.fromEntries(pairs.map(([name, factor]) => [name.trim(), Number(factor)]));
  return pairs.length && Object.values(factors).every(Number.isFinite) ? factors : undefined;
}

export class Studio {
  private session?: Session;
  private readonly opening = new Work();
  private readonly animating = new Work();
  private readonly comparing = new Work();
  private readonly live: Live;
  private readonly showForm: () => void;
  /** Keys that nobody chose: those of the start, or what a voice suggested. */
  private unchosen = [{ time: 0, emotion: FIRST, strength: 1 }];
  private settling = 0;
  private saving = 0;

  constructor(private readonly player: Player) {
    document.body.classList.add("studio");
    player.workbench!.emotion.isEditable = true;
    player.workbench!.emotion.onSelect = () => this.showEmotion();
    player.history.reset({ ...NO_EDIT, keys: this.unchosen });
    player.onEdit = () => this.edited();
    player.first = Float32Array.from(player.board.rest);
    for (const [name, value] of Object.entries(SMILE)) {
      for (const side of "LR") player.first[player.board.controls.indexOf(`CTRL_${side}_${name}`)] = value;
    }
    player.convert = convert;
    addEventListener("pagehide", () => this.leave());
    player.intake.recording = (file) => this.open(file);
    player.onTake = (take) => void this.adopt(take);
    $("pick").addEventListener("click", () => $("file").click());
    $("sample").addEventListener("click", () => void this.openSample());
    this.live = new Live(player, () => this.emotion, (...given) => new SocketVoice(player.board, ...given));
    bindMicrophone(() => player.transport.pause(), (file) => this.open(file));
    this.showForm = bindForm(player.history);
    this.showForm();
    $("emotions").append(...LABELS.map((name) => this.emotionButton(name)), this.autoButton());
    $("emotions").addEventListener("mousedown", (event) => event.preventDefault()); // a key keeps the focus
    $("exports").append(
      ...EXPORTS.map(([label, format, isLong]) => this.exportButton(label, format, isLong)),
      button("Edits", () => this.exportEdits()),
    );
    $("compare").addEventListener("click", () => void this.compare());
    $("dub").addEventListener("click", () => (this.session?.performance ? void this.dub() : $("performance").click()));
    onFile("performance", (file) => void this.dub(file));
    $("from-edited").addEventListener("click", () => $("edited").click());
    onFile("edited", (file) => void this.addChanges(file));
    $("other-changes").addEventListener("click", () => void this.addChanges(player.otherFile!));
    $("keep").addEventListener("click", () => this.setOther(player.take!.frozen("A")));
    $("drop-other").addEventListener("click", () => this.setOther());
    this.enable();
  }

  /** Continue with the session of this tab; without one, offer the latest. */
  async restore(): Promise<void> {
    try {
      const { session, view } = await loadSession(), latest = session ? undefined : await latestSession();
      if (session) await this.resume(session, view);
      if (latest) $("hint").append(button(`Continue with ${latest.name}`, () => void this.continue(latest.id)));
    } catch (error) {
      notice(`the last session cannot be read: ${messageOf(error)}`);
    }
  }

  private async continue(id: string): Promise<void> {
    try {
      const session = await sessionOf(id);
      if (session) await this.resume(session);
    } catch (error) {
      notice(`the session cannot be read: ${messageOf(error)}`);
    }
  }

  private async resume(session: Session, { range, time = 0 }: View = {}): Promise<void> {
    const edit = { ...NO_EDIT, ...session.edit }, { animated = edit } = session;
    this.begin({ ...session, edit, animated }, await this.unpacked(session.packed));
    this.player.transport.setRange(range);
    this.player.seek(time);
  }

  /** Whether the shown take is that of the edits, and nothing is on its way. */
  get isSettled(): boolean {
    const { session } = this;
    return !this.opening.isBusy && !this.animating.isBusy && session !== undefined && isSameReading(session.edit, session.animated);
  }

  /** Begin anew with a recording: in the emotion that was chosen, else in `emotion`, else in the one that its voice suggests. */
  async open(file: File, emotion?: string): Promise<void> {
    const { history } = this.player, before = history.edit.keys, isChosen = before !== this.unchosen;
    const first = isChosen ? before[0]?.emotion ?? FIRST : emotion;
    const found = await this.opening.run(`Animating ${file.name}`, async (progress, signal) => {
      const recording = new Blob([await file.arrayBuffer()]); // the file may change
      const source: Source = { recording, name: file.name, options: {}, hasOwnIntensity: false };
      return { source, ...await this.firstReading(source, first, progress, signal) };
    });
    if (!found) return;
    this.animating.cancel();
    const keys = [{ time: 0, emotion: first ?? found.take.emotionAt(0)!, strength: 1 }];
    const animated: Edit = { ...NO_EDIT, keys }, now = history.edit.keys;
    const isSame = now === before || now[0]?.emotion === keys[0].emotion;
    const edit = isSame ? animated : { ...animated, keys: [{ ...keys[0], emotion: now[0]?.emotion ?? FIRST }] };
    if (isSame && !isChosen) this.unchosen = keys;
    this.showSuggested(found.notes);
    this.begin({ ...found.source, edit, animated, packed: found.packed }, found);
    this.player.transport.play();
  }

  /** A recording in an emotion, else in the suggested one; neutral where the service suggests none. */
  private async firstReading(source: Source, emotion: string | undefined, progress: Progress, signal: AbortSignal): Promise<Reading> {
    try {
      return await this.reading({ ...source, edit: NO_EDIT, emotion: emotion ?? "auto" }, progress, signal);
    } catch (error) {
      if (emotion || !messageOf(error).includes(NO_AUTO)) throw error;
      return await this.reading({ ...source, edit: NO_EDIT, emotion: "neutral" }, progress, signal);
    }
  }

  private showSuggested(notes: string[]): void {
    $("suggested").textContent = notes.find((note) => note.startsWith(SUGGESTED))?.slice(SUGGESTED.length) ?? "";
  }

  private begin(session: Session, { take, wav }: Pick<Reading, "take" | "wav">): void {
    this.leaveGallery();
    this.session = session;
    this.player.load(take, wav, [], session.edit);
    this.enable();
  }

  private async openSample(): Promise<void> {
    try {
      const content = await (await request("/sample")).blob();
      await this.open(new File([content], "sample.flac", { type: "audio/flac" }), FIRST);
    } catch (error) {
      notice(messageOf(error));
    }
  }

  /** The emotion that the voice suggests, with the probabilities from the notes of the answer. */
  private async suggest(session: Session): Promise<void> {
    const found = await this.animating.run("Hearing the emotion", (...work) => this.reading({ ...session, emotion: "auto" }, ...work));
    if (!found) return;
    this.choose(found.take.emotionAt(0)!);
    this.showSuggested(found.notes);
  }

  /** The take as the page shows it, by the service. */
  private async reading(given: Omit<Order, "format">, progress: Progress, signal: AbortSignal): Promise<Reading> {
    const { content, notes } = await order({ ...given, format: "packed" }, progress, signal);
    const others = notes.filter((note) => !note.startsWith(SUGGESTED));
    if (others.length) notice(others.join("; "));
    return { packed: content, notes, ...await this.unpacked(content) };
  }

  private animate(session: Session, edit: Edit, intensityCsv?: string): Promise<Reading | undefined> {
    return this.animating.run("Animating", (...work) => this.reading({ ...session, edit, intensityCsv }, ...work));
  }

  /** A take that was dropped: its sound is the recording, its arguments are those of the edits. */
  private async adopt({ wav, settings, model, intensityCsv }: TakeFiles): Promise<void> {
    const { player } = this;
    this.session = undefined;
    this.opening.cancel();
    this.animating.cancel();
    this.leaveGallery();
    this.enable();
    if (!wav || !intensityCsv) return;
    const recording = new File([wav as BlobPart], player.take!.title, { type: "audio/wav" });
    const given = Object.entries(settings).filter(([name, value]) => SHOWN.includes(name) && value !== null);
    const shown = Object.fromEntries(given.map(([name, value]) => [name, typeof value === "object" ? JSON.stringify(value) : String(value)]));
    const { words = "", language = NO_EDIT.language, ...acting } = shown;
    const gains = factorsOf(settings.gain), life = factorsOf(settings.life);
    const layers = settings.edit ? parseLayers(settings.edit) : [];
    const options = { model, ...(life || !settings.life ? {} : { life: String(settings.life) }) };
    const source: Source = { recording, name: recording.name, options, weightsCsv: intensityCsv, hasOwnIntensity: true };
    const animated: Edit = { ...NO_EDIT, words, language, acting, life: life ?? {} };
    player.history.reset(animated);
    const found = await this.opening.run("Animating", (...work) => this.reading({ ...source, edit: animated, intensityCsv }, ...work));
    if (!found) return;
    this.session = { ...source, edit: animated, animated, packed: found.packed };
    if (gains || layers.length) {
      player.replace(found.take, found.wav); // the curves of the folder hold them already
      player.history.reset({ ...player.history.edit, gains: gains ?? {}, layers });
    }
    this.enable();
    this.edited();
  }

  private emotionButton(name: string): HTMLButtonElement {
    const made = button(name, () => {
      this.leaveGallery();
      if (this.live.isOn) this.live.setEmotion(name);
      this.player.workbench!.emotion.choose(name, this.player.transport.shown);
    });
    made.style.setProperty("--emotion", COLORS[name]);
    if (MOODS.includes(name)) made.title = "Procedural: no capture taught it";
    return made;
  }

  private autoButton(): HTMLButtonElement {
    const made = button("auto", () => this.session && void this.suggest(this.session));
    made.title = "The emotion that the voice suggests";
    return made;
  }

  /** After an edit: keep it, and animate again once no more edits come. */
  private edited(): void {
    const { session, player } = this;
    this.showEmotion();
    this.showForm();
    if (!session) return;
    session.edit = player.history.edit;
    this.keep();
    clearTimeout(this.settling);
    const isJob = (player.take?.seconds ?? 0) > JOB_SECONDS;
    this.settling = window.setTimeout(() => void this.settle(), isJob ? JOB_SETTLE_MS : SETTLE_MS);
  }

  private async settle(): Promise<void> {
    const { session, player } = this;
    if (!session || !player.take) return;
    const { edit } = session;
    if (!isSameReading(edit, session.animated) && !(await this.animateAgain(session, edit))) return;
    if (edit === session.edit && player.take.isBlend) await this.animatePoints(session, edit);
  }

  /** Another reading, for other keys of emotion or motion; whether it is shown. */
  private async animateAgain(session: Session, edit: Edit): Promise<boolean> {
    const found = await this.animate(session, edit, session.hasOwnIntensity ? this.readingCsv() : undefined);
    if (!found || !isSameReading(session.edit, edit)) return false;
    session.packed = found.packed;
    session.animated = edit;
    this.player.replace(found.take, found.wav);
    this.keep();
    return true;
  }

  /** Keep the face of a performance and have the recording's mouth in it; without one, the recording's own face. */
  private async dub(performance?: File): Promise<void> {
    const { session } = this, before = session?.performance;
    if (!session) return;
    session.performance = performance;
    if (!(await this.animateAgain(session, session.edit))) session.performance = before;
    this.enable();
  }

  /** Add what an edited file changes of the take, as it is now, as the last layer. */
  private async addChanges(file: File): Promise<void> {
    const { session, player } = this;
    if (!session) return;
    const { edit } = session, intensityCsv = this.hasIntensity(session) ? player.take!.intensityCsv() : undefined;
    const found = await this.comparing.run(`Comparing ${file.name}`, async (progress, signal) => {
      const take = await order({ ...session, intensityCsv, format: "take", shift: shiftOf() }, progress, signal);
      const { content, notes } = await diff(file, take.content, signal);
      return { text: await content.text(), notes };
    });
    if (!found) return;
    if (session !== this.session || edit !== session.edit) return notice(`${file.name}: the take was changed meanwhile; give the file again`);
    player.intake.layers(found.text, file.name);
    if (file === player.otherFile) this.setOther(); // the take shows its changes now
    notice([`${file.name} is the last layer`, ...found.notes].join("; "));
  }

  private async animatePoints(session: Session, edit: Edit): Promise<void> {
    const take = this.player.take!, found = await this.animate(session, edit, take.intensityCsv());
    if (!found) return;
    take.setExact(edit.points, found.take);
    this.player.replace(take, found.wav);
  }

  /** The five emotions side by side; a press on a name takes it. */
  private async compare(): Promise<void> {
    const { session, player } = this;
    if (!session || $("compare").getAttribute("aria-pressed") === "true") return this.leaveGallery();
    const takes = await this.animating.run("Animating five emotions", async (progress, signal) => {
      const found: Take[] = [];
      for (const emotion of EMOTIONS) {
        const count = (share = 0) => progress((found.length + share) / EMOTIONS.length);
        count();
        const edit = { ...session.edit, keys: [{ time: 0, emotion, strength: 1 }] };
        const intensityCsv = session.hasOwnIntensity ? this.readingCsv() : undefined;
        found.push((await this.reading({ ...session, edit, intensityCsv }, count, signal)).take);
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
  }

  private leaveGallery(): void {
    if ($("compare").getAttribute("aria-pressed") !== "true") return;
    $("compare").setAttribute("aria-pressed", "false");
    this.player.setGallery();
  }

  /** A button that writes one kind of file; files of several kinds are written at once. */
  private exportButton(label: string, format: string, isLong: boolean): HTMLButtonElement {
    const work = new Work();
    return button(label, () => void this.export(work, label, format, isLong));
  }

  /** A file of the take with its edits, as the command line writes it. */
  private async export(work: Work, label: string, format: string, isLong: boolean): Promise<void> {
    const { session, player } = this;
    if (!session) return;
    const intensityCsv = this.hasIntensity(session) ? player.take!.intensityCsv() : undefined, shift = shiftOf();
    const result = await work.run(`Exporting ${label}`, (progress, signal) =>
      order({ ...session, intensityCsv, format, shift, isLong }, progress, signal));
    if (!result) return;
    save(result.content, result.fileName);
    notice([`saved ${result.fileName}`, ...result.notes].join("; "));
  }

  /** The edits as files for the command line, which is shown with them. */
  private exportEdits(): void {
    const { session, player } = this;
    if (!session) return;
    save(new Blob([emotionCsv(session.edit, session)], { type: "text/csv" }), "emotion.csv");
    const recording = session.hasOwnIntensity ? `${session.name}/audio.wav` : session.name;
    const path = (name: string) => quoted(name.replace(/^-/, "./-"));
    const verb = session.performance ? `dub ${path(session.performance.name)}` : "animate";
    const words = [`deitalk ${verb} ${path(recording)} --emotion emotion.csv`];
    if (this.hasIntensity(session)) {
      save(new Blob([player.take!.intensityCsv()], { type: "text/csv" }), "intensity.csv");
      words.push("--intensity-curve intensity.csv");
    }
    const { edit, ...options } = optionsOf(session, session.edit);
    if (edit) {
      save(new Blob([layersText(session.edit.layers)], { type: "application/json" }), "fixes.edit.json");
      words.push("--edit fixes.edit.json");
    }
    for (const [name, value] of Object.entries({ ...options, ...shiftOf() })) {
      if (KEPT.includes(name) && !(value instanceof File)) save(new Blob([value], { type: "application/json" }), `${name}.json`);
      words.push(optionOf(name, value instanceof File ? value.name : KEPT.includes(name) ? `${name}.json` : value));
    }
    const gains = Object.entries(gainsOf(session.edit)).map(([region, gain]) => `${region}=${gain}`);
    if (gains.length) words.push(`--gain ${quoted(gains.join(","))}`);
    notice(`${words.join(" ")} -o take/`);
  }

  /** Whether the intensity is not the predicted one. */
  private hasIntensity(session: Session): boolean {
    return session.hasOwnIntensity || session.edit.points.length > 0;
  }

  /** Intensity of the shown reading before the edits. */
  private readingCsv(): string {
    return this.player.take!.intensityCsv([]);
  }

  private async unpacked(packed: Blob): Promise<Pick<Reading, "take" | "wav">> {
    const found = await unpackBytes(packed);
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
    if (!this.session) return;
    saveSession(this.session).catch((error) => notice(`the session cannot be kept: ${messageOf(error)}`));
  }

  private leave(): void {
    const { range, shown } = this.player.transport;
    keepView({ range, time: shown });
    this.save();
  }

  private enable(): void {
    const isOn = this.session !== undefined;
    for (const b of document.querySelectorAll<HTMLButtonElement>("#exports button, #compare, #dub, #from-edited, #other-changes, #keep, #add-key, #emotions button:last-child")) {
      b.disabled = !isOn;
    }
    $("dub").setAttribute("aria-pressed", String(this.session?.performance !== undefined));
    $("dub").textContent = this.session?.performance ? `Dubs ${this.session.performance.name}` : "Dub a performance";
    this.showEmotion();
    this.keep();
  }

  /** The emotion of the key in focus, or of the shown time. */
  private get emotion(): string {
    return this.player.workbench!.emotion.emotionAt(this.player.transport.shown);
  }

  private showEmotion(): void {
    for (const b of document.querySelectorAll("#emotions button")) {
      b.setAttribute("aria-pressed", String(b.textContent === this.emotion));
    }
  }
}
