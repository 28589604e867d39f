/** Playback time: the recording's clock if there is a recording, else the computer's. */

export class Clock {
  audio?: HTMLAudioElement;
  seconds = 0;
  private started = 0;
  private held = 0;
  private running = false;
  rate = 1;

  /** Begin with another recording, or none, at 0. */
  load(wav: Uint8Array | null, seconds: number): void {
    if (this.audio) URL.revokeObjectURL(this.audio.src);
    this.audio = undefined;
    this.seconds = seconds;
    this.held = 0;
    if (!wav) return;
    this.audio = new Audio(URL.createObjectURL(new Blob([wav as BlobPart], { type: "audio/wav" })));
    this.audio.preload = "auto";
    this.audio.playbackRate = this.rate;
  }

  get isAtEnd(): boolean {
    return this.time >= this.seconds - 0.001 || !!this.audio?.ended;
  }

  get playing(): boolean {
    return this.running;
  }

  get time(): number {
    if (this.audio) return this.audio.currentTime;
    if (!this.running) return this.held;
    return Math.min(this.held + ((performance.now() - this.started) / 1000) * this.rate, this.seconds);
  }

  async play(): Promise<void> {
    if (this.time >= this.seconds - 0.02) this.seek(0);
    this.running = true;
    if (this.audio) {
      this.audio.playbackRate = this.rate;
      await this.audio.play();
    } else this.started = performance.now();
  }

  pause(): void {
    this.held = this.time;
    this.running = false;
    this.audio?.pause();
  }

  seek(seconds: number): void {
    const to = Math.min(Math.max(seconds, 0), this.seconds);
    this.held = to;
    this.started = performance.now();
    if (this.audio) this.audio.currentTime = Math.min(to, this.audio.duration || to);
  }

  setRate(rate: number): void {
    this.held = this.time;
    this.started = performance.now();
    this.rate = rate;
    if (this.audio) this.audio.playbackRate = rate;
  }
}
