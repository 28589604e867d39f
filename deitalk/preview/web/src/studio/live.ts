/** The microphone straight to the face: sound to a voice, its frames at the pace of the sound. */

import { $, messageOf, notice } from "../dom";
import type { Player } from "../player";
import { openMicrophone } from "./microphone";

/** Samples of a block at most, and its seconds. */
const MOST_SAMPLES = 2048, BLOCK_SECONDS = 0.05;
/** Where more sound than this waits to be shown, all but a part is skipped, seconds. */
const MOST_WAITING = 0.8, KEPT_WAITING = 0.4;

export interface Frame {
  time: number;
  /** Seconds since the frame's sound came. */
  late: number;
  /** Curves of the board. */
  values: Float32Array;
  /** Turn and shift of the head, where it is known. */
  head?: Float32Array;
}

/** What animates sound as it comes: a session of a service, or the model of the page. */
export interface Voice {
  feed(samples: Float32Array): void;
  /** Change the emotion of what is said from now on. */
  setEmotion(emotion: string): void;
  stop(): void;
}

export interface Listener {
  /** The voice takes sound from now on. */
  ready(): void;
  frame(frame: Frame): void;
  /** The voice ended by itself. */
  ended(): void;
}

export class Live {
  private voice?: Voice;
  private stream?: MediaStream;
  private context?: AudioContext;
  private frames: Frame[] = [];
  /** Seconds of the page's clock at which the shown sound begins; unknown while no frame waits. */
  private began?: number;

  /** `rate` is that of the samples, where the voices take no other. */
  constructor(
    private readonly player: Player,
    private readonly emotion: () => string,
    private readonly open: (rate: number, emotion: string, listener: Listener) => Voice,
    private readonly rate?: number,
  ) {
    $("live").addEventListener("click", () => (this.voice ? this.stop() : void this.start()));
  }

  get isOn(): boolean {
    return this.voice !== undefined;
  }

  setEmotion(emotion: string): void {
    this.voice?.setEmotion(emotion);
  }

  stop(): void {
    this.voice?.stop();
    this.close();
  }

  private async start(): Promise<void> {
    this.player.transport.pause();
    try {
      this.stream = await openMicrophone(true);
      this.context = new AudioContext(this.rate ? { sampleRate: this.rate } : undefined);
    } catch (error) {
      this.close();
      return notice(`the microphone cannot be used: ${messageOf(error)}`);
    }
    const voice: Voice = this.open(this.context.sampleRate, this.emotion(), {
      ready: () => this.listen(voice),
      frame: (frame) => this.frames.push(frame),
      ended: () => voice === this.voice && this.close(),
    });
    this.voice = voice;
    this.label(true);
    $("recorded").textContent = "starting";
    this.draw();
  }

  /** Give the voice every block of the microphone; nothing is played. */
  private listen(voice: Voice): void {
    const { context, stream } = this;
    if (voice !== this.voice || !context || !stream) return;
    const source = context.createMediaStreamSource(stream);
    const size = Math.min(2 ** Math.round(Math.log2(BLOCK_SECONDS * context.sampleRate)), MOST_SAMPLES);
    const blocks = context.createScriptProcessor(size, 1, 1);
    blocks.onaudioprocess = ({ inputBuffer }) => voice === this.voice && voice.feed(inputBuffer.getChannelData(0).slice());
    source.connect(blocks).connect(context.destination);
  }

  /** Show frames at the pace at which they were spoken; wait where there is none, skip where there are many. */
  private draw = (): void => {
    if (!this.voice) return;
    const now = performance.now() / 1000, { frames } = this;
    if (frames.length) {
      const first = frames[0].time, last = frames[frames.length - 1].time;
      if (this.began === undefined) this.began = now - first;
      if (last - (now - this.began) > MOST_WAITING) this.began = now - last + KEPT_WAITING;
      let shown: Frame | undefined;
      while (frames.length && frames[0].time <= now - this.began) shown = frames.shift();
      if (shown) this.show(shown);
      if (!frames.length) this.began = undefined;
    }
    requestAnimationFrame(this.draw);
  };

  private show({ values, head, late }: Frame): void {
    this.player.showLive(values, head);
    $("recorded").textContent = `${late.toFixed(1)} s late`;
  }

  private close(): void {
    this.voice = undefined;
    this.stream?.getTracks().forEach((track) => track.stop());
    void this.context?.close();
    this.stream = this.context = undefined;
    this.frames = [];
    this.began = undefined;
    this.label(false);
    this.player.showLive();
  }

  private label(on: boolean): void {
    const button = $("live");
    button.textContent = on ? "Stop live" : "Live";
    button.setAttribute("aria-pressed", String(on));
    $<HTMLButtonElement>("record").disabled = on;
    if (!on) $("recorded").textContent = "";
  }
}
