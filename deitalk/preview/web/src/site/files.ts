/** Curves as files: CSV and JSON of `deitalk`, and the CSV of Live Link Face with raw curves. */

import type { Take } from "../data/take";
import type { Facts } from "./engine";

const short = (x: number) => String(Number(x.toFixed(6)));

export function csvOf(take: Take): string {
  const { controls } = take.board;
  const rows = Array.from({ length: take.frames }, (_, k) => [k, (k / take.fps).toFixed(6), ...Array.from(take.frame(k), short)].join(","));
  return `${["frame", "time", ...controls].join(",")}\n${rows.join("\n")}\n`;
}

export function jsonOf(take: Take, controlSet: string): string {
  const values = Array.from({ length: take.frames }, (_, k) => Array.from(take.frame(k), (x) => Number(short(x))));
  return JSON.stringify({
    schema: "deitalk.curves/1", control_set: controlSet, fps: take.fps, n_frames: take.frames, names: take.board.controls, values,
  });
}

/** A value between knots on straight lines. */
function between(x: number, places: number[], values: number[]): number {
  const after = places.findIndex((place) => place >= x);
  if (after === 0) return values[0];
  if (after < 0) return values[values.length - 1];
  const share = (x - places[after - 1]) / (places[after] - places[after - 1]);
  return values[after - 1] + share * (values[after] - values[after - 1]);
}

const pad = (number: number, width: number) => String(number).padStart(width, "0");

/** HH:MM:SS:FF.mmm in sixtieths of a second, as the app counts. */
function timecode(ticks: number): string {
  const sixtieths = Math.floor(ticks / 1000);
  const fields = [Math.floor(sixtieths / 216000) % 24, Math.floor(sixtieths / 3600) % 60, Math.floor(sixtieths / 60) % 60, sixtieths % 60];
  return `${fields.map((field) => pad(field, 2)).join(":")}.${pad(ticks % 1000, 3)}`;
}

export function liveLinkOf(take: Take, { raw, subject }: Facts): string {
  const { controls } = take.board, place = (name: string) => controls.indexOf(name);
  const columns = raw.map((curve) => ({ ...curve, at: place(curve.control), both: place(curve.control.replace(/^CTRL_[LR]_eye\.t/, "CTRL_C_eye.t")) }));
  const rest = subject.map((_, k) => (k < 7 ? 0 : 1));
  const row = (k: number) => {
    const values = take.frame(k);
    const curves = columns.map(({ at, both, rest, places, values: heights }) => {
      if (at < 0) return rest;
      const x = both >= 0 && both !== at ? Math.min(Math.max(values[at] + values[both], -1), 1) : values[at];
      return between(x, places, heights);
    });
    return [...curves, ...rest].map((x) => x.toFixed(10));
  };
  const count = raw.length + subject.length, step = 60000 / take.fps;
  const rows = Array.from({ length: take.frames }, (_, k) => [timecode(Math.round(k * step)), count, ...row(k)]);
  // A take that ends within half a second would be read as thirtieths: its last frame is held.
  for (let ticks = Math.round(take.frames * step); take.frames > 1 && rows.every(([code]) => Number(String(code).slice(9)) <= 30); ticks += Math.round(step)) {
    rows.push([timecode(ticks), ...rows[rows.length - 1].slice(1)]);
  }
  return `${["Timecode", "BlendshapeCount", ...raw.map(({ name }) => name), ...subject].join(",")}\n${rows.map((cells) => cells.join(",")).join("\n")}\n`;
}
