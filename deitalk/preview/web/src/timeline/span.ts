/** The part of the time axis that all lanes show. */

const LEAST_SECONDS = 0.2;

export class Span {
  start = 0;
  end = 1;
  total = 1;

  constructor(private readonly changed: () => void) {}

  get seconds(): number {
    return this.end - this.start;
  }

  get isWhole(): boolean {
    return this.seconds >= this.total;
  }

  reset(total: number): void {
    this.total = Math.max(total, LEAST_SECONDS);
    this.show(0, this.total);
  }

  /** Position of a time in a lane of some width. */
  x(time: number, width: number): number {
    return ((time - this.start) / this.seconds) * width;
  }

  time(x: number, width: number): number {
    return Math.min(Math.max(this.start + (x / width) * this.seconds, 0), this.total);
  }

  /** Show `by` times as much, with `around` at the same place. */
  zoom(by: number, around: number): void {
    const seconds = Math.min(Math.max(this.seconds * by, LEAST_SECONDS), this.total);
    const start = around - ((around - this.start) / this.seconds) * seconds;
    this.show(start, start + seconds);
  }

  pan(seconds: number): void {
    this.show(this.start + seconds, this.end + seconds);
  }

  fit(): void {
    this.show(0, this.total);
  }

  /** Turn the page when playback leaves the span. */
  follow(time: number): void {
    if (time < this.start || time > this.end) this.show(time, time + this.seconds);
  }

  private show(start: number, end: number): void {
    const seconds = Math.min(end - start, this.total);
    this.start = Math.min(Math.max(start, 0), this.total - seconds);
    this.end = this.start + seconds;
    this.changed();
  }
}
