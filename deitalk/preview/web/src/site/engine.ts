/** The model of a page without a service: samples in, finished curves out, in a worker. */

export const RATE = 16000, FPS = 30;

/** What `deitalk export web` says of the model. */
export interface Facts {
  emotions: string[];
  actors: string[];
  variants: number;
  motion: number;
  rest: number;
  /** Of each raw curve of a MetaHuman: its control, and places and values of its knots. */
  raw: { name: string; control: string; rest: number; places: number[]; values: number[] }[];
  subject: string[];
  /** Of the model of live voices, if the folder has one: frames of a run, its samples from `before` ahead of its first frame on, and frames by which what is given is behind. */
  live?: { frames: number; window: number; before: number; delay: number; behind: number; state: number; actors: number };
}

export interface Finished {
  curves: Float32Array;
  neutral: Float32Array;
  predicted: Float32Array;
  seconds: number;
}

type Inputs = Record<string, { data: Float32Array; dims: number[] }>;

export class Engine {
  private readonly worker = new Worker(new URL("engine.js", location.href), { type: "module" });
  private readonly waiting = new Map<number, { done: (found: Finished) => void; fail: (error: Error) => void }>();
  private count = 0;

  constructor(readonly facts: Facts) {
    this.worker.onmessage = ({ data: { number, outputs, seconds, error } }) => {
      const { done, fail } = this.waiting.get(number)!;
      this.waiting.delete(number);
      if (error) fail(new Error(error));
      else done({ ...outputs, seconds });
    };
    this.worker.onerror = (event) => {
      const error = new Error(event.message || "the model cannot be loaded; open this folder by a web server");
      this.waiting.forEach(({ fail }) => fail(error));
      this.waiting.clear();
    };
  }

  /** Animate samples at 16 kHz with weights of emotions (T, 9), in the intensity of the voice or in that of a curve (T,). */
  animate(sound: Float32Array, emotion: Float32Array, curve?: ArrayLike<number>): Promise<Finished> {
    const { facts } = this, frames = frameCount(sound.length), width = facts.emotions.length + facts.actors.length;
    const rows = new Float32Array(frames * width), intensity = new Float32Array(3 * frames);
    for (let k = 0; k < frames; k++) rows.set(emotion.subarray(k * facts.emotions.length, (k + 1) * facts.emotions.length), k * width);
    intensity.fill(-1, 0, frames).fill(1, frames, 2 * frames).fill(facts.rest, 2 * frames);
    if (curve) intensity.set(curve);
    const inputs: Inputs = {
      sound: { data: sound, dims: [sound.length] },
      emotion: { data: rows, dims: [frames, width] },
      intensity: { data: intensity, dims: [3, frames] },
      variants: { data: new Float32Array(frames * facts.variants), dims: [frames, facts.variants] },
      motion: { data: new Float32Array(frames * facts.motion), dims: [frames, facts.motion] },
    };
    return this.run("model", inputs);
  }

  /** Take the sound of the next frames of a live voice, and their emotions; its state, which is new where the voice `begins`, stays in the worker. */
  async next(sound: Float32Array, emotion: Float32Array, begins: boolean): Promise<Float32Array> {
    const { facts } = this, { frames, state } = facts.live!;
    const row = (data: Float32Array) => ({ data, dims: [1, data.length] });
    const rows = (data: Float32Array) => ({ data, dims: [1, frames, data.length / frames] });
    const inputs: Inputs = {
      sound: row(sound),
      emotion: rows(emotion),
      intensity: row(Float32Array.of(1, facts.rest)),
      variants: rows(new Float32Array(frames * facts.variants)),
      motion: rows(new Float32Array(frames * facts.motion)),
    };
    if (begins) inputs.state = row(new Float32Array(state));
    return (await this.run("live", inputs)).curves;
  }

  private run(model: "model" | "live", inputs: Inputs): Promise<Finished> {
    const number = this.count++;
    return new Promise((done, fail) => {
      this.waiting.set(number, { done, fail });
      this.worker.postMessage({ number, model, inputs });
    });
  }
}

export const frameCount = (samples: number) => Math.ceil((FPS * samples) / RATE);

/** Mono samples at 16 kHz of a file that this browser decodes. */
export async function samplesOf(file: Blob): Promise<Float32Array> {
  const sound = await new OfflineAudioContext(1, 1, RATE).decodeAudioData(await file.arrayBuffer());
  const mono = new Float32Array(sound.length);
  for (let channel = 0; channel < sound.numberOfChannels; channel++) {
    sound.getChannelData(channel).forEach((x, k) => (mono[k] += x / sound.numberOfChannels));
  }
  return mono;
}
