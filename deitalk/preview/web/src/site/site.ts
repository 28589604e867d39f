/** A page without a service: recordings are animated in the page itself, and nothing leaves the machine. */

import { type EmotionKey, NO_EDIT } from "../data/edit";
import { Take } from "../data/take";
import { $, button, messageOf, notice, save } from "../dom";
import type { Player } from "../player";
import { Live } from "../studio/live";
import { bindMicrophone } from "../studio/microphone";
import { wavOf } from "../studio/wav";
import { Work } from "../studio/work";
import { COLORS } from "../timeline/emotion";
import { Engine, type Facts, type Finished, FPS, frameCount, RATE, samplesOf } from "./engine";
import { csvOf, jsonOf, liveLinkOf } from "./files";
import { EngineVoice } from "./voice";

const FIRST = "happy", SETTLE_MS = 350;
/** Silence that is animated when the page opens: the browser compiles the model's operators by then. */
const WARM_SECONDS = 2;

export class Site {
  readonly engine: Engine;
  private readonly live?: Live;
  private readonly work = new Work();
  private sound?: Float32Array;
  private name = "";
  private keys?: readonly EmotionKey[];
  private settling = 0;
  /** Seconds of the last run. */
  took = 0;
  /** Whether the model is read and its operators are compiled. */
  isWarm = false;

  constructor(private readonly player: Player, readonly facts: Facts) {
    this.engine = new Engine(facts);
    void this.warmUp();
    document.body.classList.add("studio", "site");
    player.workbench!.emotion.isEditable = true;
    player.history.reset({ ...NO_EDIT, keys: [{ time: 0, emotion: FIRST, strength: 1 }] });
    player.onEdit = () => this.edited();
    player.intake.recording = (file) => this.open(file);
    $("pick").addEventListener("click", () => $("file").click());
    bindMicrophone(() => player.transport.pause(), (file) => this.open(file));
    if (facts.live) this.live = new Live(player, () => this.emotion, (_, ...given) => new EngineVoice(this.engine, ...given), RATE);
    else $("live").style.display = "none";
    $("emotions").append(...facts.emotions.map((name) => this.emotionButton(name)));
    const kinds: [string, string, (take: Take) => string][] = [
      ["CSV", "curves.csv", csvOf],
      ["JSON", "curves.json", (take) => jsonOf(take, "metahuman-185@mh4")],
      ["Live Link", "take_1_deitalk.csv", (take) => liveLinkOf(take, facts)],
    ];
    $("exports").append(...kinds.map(([label, end, text]) => button(label, () => this.save(text, end))));
    this.enable();
  }

  private async warmUp(): Promise<void> {
    const silence = new Float32Array(WARM_SECONDS * RATE), frames = frameCount(silence.length);
    try {
      await this.engine.animate(silence, new Float32Array(frames * this.facts.emotions.length));
      this.isWarm = true;
    } catch (error) {
      notice(messageOf(error));
    }
  }

  /** Animate a recording, and play it. */
  async open(file: File): Promise<void> {
    const found = await this.work.run(`Animating ${file.name}`, async () => {
      const sound = await samplesOf(file);
      if (!sound.length) throw new Error(`${file.name} has no sound`);
      this.name = file.name.replace(/\.[^.]*$/, "");
      return { sound, ...await this.reading(sound, this.player.history.edit.keys) };
    });
    if (!found) return;
    const { keys } = this.player.history.edit;
    this.sound = found.sound;

    this.keys = keys;
    const peak = found.sound.reduce((most, x) => Math.max(most, Math.abs(x)), 1);
    const samples = Int16Array.from(found.sound, (x) => Math.round((32767 * x) / peak));
    this.player.load(found.take, wavOf(samples, RATE), [], { ...NO_EDIT, keys });
    this.enable();
    this.player.transport.play();
  }

  /** Weights (T, 9) of keys: linear between them, what is left is neutral. */
  weights(keys: readonly EmotionKey[], frames: number): Float32Array {
    const { emotions } = this.facts, rows = new Float32Array(frames * emotions.length);
    for (let k = 0; k < frames; k++) {
      const time = k / FPS, after = keys.findIndex((key) => key.time >= time);
      const [a, b] = after === 0 ? [keys[0], keys[0]] : after < 0 ? [keys[keys.length - 1], keys[keys.length - 1]] : [keys[after - 1], keys[after]];
      const share = a === b ? 0 : (time - a.time) / (b.time - a.time);
      const row = rows.subarray(k * emotions.length, (k + 1) * emotions.length);
      for (const [key, part] of [[a, 1 - share], [b, share]] as const) {
        row[emotions.indexOf(key.emotion)] += part * key.strength;
        row[0] += part * (1 - key.strength);
      }
    }
    return rows;
  }

  private async reading(sound: Float32Array, keys: readonly EmotionKey[], curve?: ArrayLike<number>): Promise<{ take: Take; found: Finished }> {
    const frames = frameCount(sound.length), emotion = this.weights(keys, frames);
    const found = await this.engine.animate(sound, emotion, curve);
    this.took = found.seconds;
    const facts = { title: this.name, fps: FPS, frames, emotions: this.facts.emotions, audioSeconds: sound.length / RATE };
    const arrays = { values: found.curves, neutral: found.neutral, emotion, intensity: curve ? Float32Array.from(curve) : found.predicted };
    return { take: new Take({ facts, arrays }, this.player.board), found };
  }

  private edited(): void {
    clearTimeout(this.settling);
    this.settling = window.setTimeout(() => void this.settle(), SETTLE_MS);
  }

  /** Animate again for other keys, then for points of the intensity. */
  private async settle(): Promise<void> {
    const { player, sound } = this, { edit } = player.history;
    if (!sound || !player.take) return;
    if (edit.keys !== this.keys) {
      const found = await this.work.run("Animating", () => this.reading(sound, edit.keys));
      if (!found || edit.keys !== player.history.edit.keys) return;
      this.keys = edit.keys;
      player.replace(found.take, null);
    }
    const { take } = player;
    if (!take?.isBlend) return;
    const curve = Array.from({ length: take.frames }, (_, k) => take.intensityAt(k));
    const found = await this.work.run("Animating", () => this.reading(sound, edit.keys, curve));
    if (!found) return;
    take.setExact(edit.points, found.take);
    player.replace(take, null);
  }

  /** Emotion at the place that is shown. */
  private get emotion(): string {
    const { keys } = this.player.history.edit, { shown } = this.player.transport;
    return (keys.filter(({ time }) => time <= shown).pop() ?? keys[0]).emotion;
  }

  private emotionButton(name: string): HTMLButtonElement {
    const made = button(name, () => {
      this.live?.setEmotion(name);
      this.player.workbench!.emotion.choose(name, this.player.transport.shown);
    });
    made.style.setProperty("--emotion", COLORS[name]);
    return made;
  }

  private save(text: (take: Take) => string, end: string): void {
    const { take } = this.player;
    if (take) save(new Blob([text(take)]), `${this.name || "take"}_${end}`);
  }

  private enable(): void {
    $("exports").querySelectorAll("button").forEach((one) => (one.disabled = !this.player.take));
  }
}
