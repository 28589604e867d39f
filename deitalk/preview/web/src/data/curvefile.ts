/** Curves from the files that `deitalk` writes: CSV, JSON, and take folders or their archives. */

import type { Packed } from "./packed";
import schema from "./acting.json";
import type { Board } from "./board";
import { readNpy, unzip } from "./zip";

const EMOTIONS = Object.keys(schema.properties.emotion["x-colors"]);

interface Columns {
  names: string[];
  rows: number[][];
  fps: number;
  emotion?: number[][];
  emotions?: string[];
  intensity?: number[];
  head?: number[][];
}

/** What a take folder gives beside its curves. */
export interface TakeFiles {
  packed: Packed;
  wav?: Uint8Array;
  /** Arguments of `deitalk animate`, of `take.json`. */
  settings: Record<string, any>;
  /** Name of the model. */
  model: string;
  /** Text of `intensity.csv`: weights of the emotions and applied intensity. */
  intensityCsv: string;
}

/** A file of curves in the order of the board, as the page's own arrays. */
export async function readCurves(file: File, board: Board): Promise<Packed> {
  const text = await file.text();
  const columns = file.name.toLowerCase().endsWith(".json") ? fromJson(text) : fromCsv(text);
  return packed(columns, board, file.name.replace(/\.[^.]*$/, ""));
}

/** A take folder: `curves.json`, and where they are there `neutral.npz`, `audio.wav`, `intensity.csv`, `take.json`. */
export async function readTake(files: Map<string, Uint8Array>, title: string, board: Board): Promise<TakeFiles> {
  const text = (name: string) => new TextDecoder().decode(files.get(name));
  if (!files.has("curves.json")) throw new Error("it has no curves.json; drop a folder that deitalk animate wrote");
  const take = packed(fromJson(text("curves.json")), board, title);
  if (files.has("neutral.npz")) take.arrays.neutral = await neutralOf(files.get("neutral.npz")!, take.arrays.values.length);
  const wav = files.get("audio.wav");
  if (wav) take.facts.audioSeconds = (wav.length - 44) / 2 / new DataView(wav.buffer, wav.byteOffset).getUint32(24, true);
  const about = files.has("take.json") ? JSON.parse(text("take.json")) : {};
  const model = String(about.model?.name ?? "default");
  return { packed: take, wav, settings: about.settings ?? {}, model, intensityCsv: text("intensity.csv") };
}

/** The files of a zipped take, without the folder they may lie in. */
export async function filesOfZip(data: ArrayBuffer): Promise<Map<string, Uint8Array>> {
  const files = await unzip(data);
  return new Map([...files].map(([name, bytes]) => [name.split("/").pop()!, bytes]));
}

async function neutralOf(npz: Uint8Array, length: number): Promise<Float32Array> {
  const arrays = await unzip(npz.slice().buffer as ArrayBuffer);
  const values = readNpy(arrays.get("values.npy") ?? new Uint8Array());
  if (values.length !== length) throw new Error("neutral.npz has other frames or controls than curves.json");
  return values;
}

function fromJson(text: string): Columns {
  const data = JSON.parse(text);
  if (!Array.isArray(data?.names) || !Array.isArray(data?.values)) {
    throw new Error("it holds no curves; give a curves.json or curves.csv of deitalk");
  }
  return { names: data.names, rows: data.values, fps: data.fps, emotion: data.emotion, intensity: data.intensity, head: data.head, emotions: data.emotion_names };
}

function fromCsv(text: string): Columns {
  const [head, ...lines] = text.trim().split(/\r?\n/).map((line) => line.split(","));
  const time = head.indexOf("time"), used = head.map((_, k) => k).filter((k) => head[k].startsWith("CTRL_"));
  if (time < 0 || !used.length || lines.length < 2) {
    throw new Error("it has no columns time and CTRL_…; convert it first: deitalk convert FILE curves.csv");
  }
  const rows = lines.map((cells) => used.map((k) => Number(cells[k])));
  const seconds = Number(lines[lines.length - 1][time]) - Number(lines[0][time]);
  return { names: used.map((k) => head[k]), rows, fps: Math.round((1000 * (lines.length - 1)) / seconds) / 1000 };
}

function packed({ names, rows, fps, emotion, intensity, head, emotions = EMOTIONS }: Columns, board: Board, title: string): Packed {
  const n = board.controls.length, values = new Float32Array(rows.length * n);
  const places = board.controls.map((name) => names.indexOf(name));
  if (places.every((place) => place < 0)) throw new Error("none of its curves is a control of the board");
  rows.forEach((row, f) => places.forEach((place, c) => (values[f * n + c] = place < 0 ? board.rest[c] : row[place])));
  const tracks = [emotion, intensity, head].filter((track) => track && track.length !== rows.length);
  if (!rows.length || tracks.length) throw new Error("its tracks are not of one length");
  if (!(fps > 0 && fps < Infinity) || values.some((value) => !Number.isFinite(value))) throw new Error("its numbers are not all finite");
  const arrays: Packed["arrays"] = { values };
  if (emotion) arrays.emotion = Float32Array.from(emotion.flat());
  if (intensity) arrays.intensity = Float32Array.from(intensity);
  if (head) arrays.head = Float32Array.from(head.flat());
  return { facts: { title, fps, frames: rows.length, emotions, warnings: [] }, arrays };
}
