/** A live voice of the page's own model: samples at 16 kHz in, frames out as soon as they are known. */

import { messageOf, notice } from "../dom";
import type { Listener, Voice } from "../studio/live";
import { type Engine, FPS, RATE } from "./engine";

/** Time over which one emotion passes into the next, seconds. */
const RAMP_SECONDS = 0.2;
/** Sound that waits for the model at most, seconds; more is skipped. */
const MOST_WAITING = 1;

export class EngineVoice implements Voice {
  /** The last samples, and the number of the first of them. */
  private samples = new Float32Array(0);
  private begin = 0;
  /** Frames that the model has taken so far. */
  private taken = 0;
  private isBusy = false;
  private isStopped = false;
  /** Emotion before and after the last change, and its time in the sound. */
  private change: { from: Float32Array; to: Float32Array; seconds: number };

  constructor(private readonly engine: Engine, emotion: string, private readonly listener: Listener) {
    const row = this.row(emotion);
    this.change = { from: row, to: row, seconds: 0 };
    void this.begun();
  }

  /** Read the model by a run of silence; no sound is taken before. */
  private async begun(): Promise<void> {
    try {
      await this.engine.next(new Float32Array(this.engine.facts.live!.window), this.emotions(), true);
      this.listener.ready();
    } catch (error) {
      this.fail(error);
    }
  }

  private fail(error: unknown): void {
    notice(messageOf(error));
    this.isStopped = true;
    this.listener.ended();
  }

  feed(samples: Float32Array): void {
    if (this.heard - (this.taken * RATE) / FPS > MOST_WAITING * RATE) {
      notice("this machine is too slow for live: sound is skipped");
      return;
    }
    const kept = this.samples;
    this.samples = new Float32Array(kept.length + samples.length);
    this.samples.set(kept);
    this.samples.set(samples, kept.length);
    if (!this.isBusy) void this.advance();
  }

  setEmotion(emotion: string): void {
    const seconds = this.heard / RATE;
    this.change = { from: this.emotionAt(seconds), to: this.row(emotion), seconds };
  }

  stop(): void {
    this.isStopped = true;
  }

  /** Samples that have come. */
  private get heard(): number {
    return this.begin + this.samples.length;
  }

  /** Run the model on the sound that has come, a few frames a run. */
  private async advance(): Promise<void> {
    this.isBusy = true;
    try {
      const { frames, window, before, behind } = this.engine.facts.live!;
      for (;;) {
        const first = Math.floor((this.taken * RATE) / FPS) - before;
        if (this.isStopped || first + window > this.heard) break;
        const sound = new Float32Array(window), skipped = Math.max(first, 0);
        sound.set(this.samples.subarray(skipped - this.begin, first + window - this.begin), skipped - first);
        const curves = await this.engine.next(sound, this.emotions(), this.taken === 0), width = curves.length / frames;
        for (let k = 0; k < frames && !this.isStopped; k++) {
          const frame = this.taken++ - behind, values = curves.subarray(k * width, (k + 1) * width);
          if (frame >= 0) this.listener.frame({ time: frame / FPS, late: this.heard / RATE - (frame + 1) / FPS, values });
        }
        if (skipped - this.begin > RATE) {
          this.samples = this.samples.slice(skipped - this.begin);
          this.begin = skipped;
        }
      }
    } catch (error) {
      this.fail(error);
    } finally {
      this.isBusy = false;
    }
  }

  private row(emotion: string): Float32Array {
    const { emotions, live } = this.engine.facts;
    return Float32Array.from({ length: emotions.length + live!.actors }, (_, k) => Number(emotions[k] === emotion));
  }

  /** Emotions of the frames that the next run reads, one after the other. */
  private emotions(): Float32Array {
    const { frames, delay } = this.engine.facts.live!, width = this.change.to.length, rows = new Float32Array(frames * width);
    for (let k = 0; k < frames; k++) rows.set(this.emotionAt(Math.max(this.taken + k - delay, 0) / FPS), k * width);
    return rows;
  }

  private emotionAt(seconds: number): Float32Array {
    const { from, to, seconds: begin } = this.change, share = Math.min(Math.max((seconds - begin) / RAMP_SECONDS, 0), 1);
    return from.map((x, k) => x + share * (to[k] - x));
  }
}
