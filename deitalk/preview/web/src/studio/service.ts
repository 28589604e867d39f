/** Requests to the service that gave the page: recordings to takes and files. */

import { type Edit, gainsOf } from "../data/edit";
import { $ } from "../dom";
import { FIELDS } from "./form";

const POLL_MS = 300;
const KEY = "deitalk-key";

/** Share that is done, 0 to 1; undefined while it is unknown. */
export type Progress = (share?: number) => void;

/** What a take is made of. */
export interface Source {
  recording: Blob;
  /** For the files that are written. */
  name: string;
  /** Arguments beside emotion and intensity, such as the seed, of a take that was dropped. */
  options: Record<string, string>;
  /** Captured or keyed curves, or a zipped take, whose mouth is replaced. */
  performance?: File;
  /** Weights of the emotions of a dropped take, while it has no keys. */
  weightsCsv?: string;
  /** Whether the intensity is that of a dropped take, not the predicted one. */
  hasOwnIntensity: boolean;
}

export interface Order extends Source {
  edit: Edit;
  /** `auto` or a name instead of the keys of the edit. */
  emotion?: string;
  /** `intensity.csv` to apply instead of the predicted intensity. */
  intensityCsv?: string;
  format: string;
  /** How a file is written: frames by which the face is late, and handles. */
  shift?: Record<string, string>;
  /** Make it a job, whose progress is known. */
  isLong?: boolean;
}

export interface Result {
  content: Blob;
  notes: string[];
  fileName: string;
}

/** Keys of emotion, or weights, in the columns that `deitalk.emotions` reads. */
export function emotionCsv(edit: Edit, source: Source): string {
  if (!edit.keys.length && source.weightsCsv) return source.weightsCsv;
  const rows = edit.keys.map((key) => `${key.time.toFixed(6)},${key.emotion},${key.strength}`);
  return `time,emotion,strength\n${rows.join("\n")}\n`;
}

/** Arguments of an edit beside emotion and intensity. */
export function optionsOf(source: Source, edit: Edit): Record<string, string | File> {
  const life = Object.entries(edit.life).filter(([, factor]) => factor !== 1).map(([part, factor]) => `${part}=${factor}`);
  const words = edit.words?.trim(), layers = edit.layers ?? [];
  return {
    ...source.options,
    ...edit.acting,
    ...(life.length ? { life: life.join(",") } : {}),
    ...(layers.some((layer) => layer.edits.length) ? { edit: JSON.stringify(layers) } : {}),
    ...(words ? { words, language: edit.language || "en-us" } : {}),
  };
}

/** An argument as the command line spells it. */
export function optionOf(name: string, value: string): string {
  const option = `--${name.replaceAll("_", "-")}`;
  if (FIELDS[name]?.type === "boolean") return value === "true" ? option : `--no-${name}`;
  return `${option} ${quoted(value)}`;
}

/** A word as a shell reads it. */
export function quoted(word: string): string {
  return /^[\w.,=:/-]+$/.test(word) ? word : `'${word.replace(/\s+/g, " ").replace(/'/g, `'\\''`)}'`;
}

/** A name that the service takes for a file. */
export function fileNameOf(title: string): string {
  return title.replace(/\.[^.]*$/, "").replace(/[^A-Za-z0-9 _-]+/g, "_").replace(/^[^A-Za-z0-9]+|[^A-Za-z0-9]+$/g, "").slice(0, 60) || "take";
}

export async function order(given: Order, progress: Progress, signal: AbortSignal): Promise<Result> {
  const form = new FormData();
  form.append("recording", given.recording, "recording");
  if (given.emotion) form.append("emotion", given.emotion);
  else form.append("emotion", new Blob([emotionCsv(given.edit, given)]), "emotion.csv");
  if (given.intensityCsv) form.append("intensity_curve", new Blob([given.intensityCsv]), "intensity.csv");
  const gains = Object.entries(gainsOf(given.edit)).map(([region, gain]) => `${region}=${gain}`);
  if (gains.length && given.format !== "packed") form.append("gain", gains.join(","));
  const { edit, ...options } = optionsOf(given, given.edit);
  if (edit && given.format !== "packed") form.append("edit", edit); // the page applies them itself
  for (const [name, value] of Object.entries({ ...options, ...given.shift })) form.append(name, value);
  form.append("format", given.format);
  form.append("name", fileNameOf(given.name));
  if (given.performance) form.append("performance", given.performance);
  if (given.isLong) form.append("wait", "false");
  const path = given.performance ? "/v1/dubs" : "/v1/animations";
  const answer = await request(path, { method: "POST", body: form, signal });
  return answer.status === 202 ? await finished(await answer.json(), progress, signal) : await resultOf(answer);
}

/** A file of curves of any format as `curves.json` of the board. */
export async function convert(file: File): Promise<File> {
  const form = new FormData();
  form.append("curves", file, file.name);
  form.append("format", "json");
  const { content } = await resultOf(await request("/v1/conversions", { method: "POST", body: form }));
  return new File([content], `${file.name.replace(/\.[^.]*$/, "")}.json`);
}

/** What a file of edited curves changes of a zipped take, as a layer. */
export async function diff(edited: File, take: Blob, signal: AbortSignal): Promise<Result> {
  const form = new FormData();
  form.append("edited", edited, edited.name);
  form.append("take", take, "take.zip");
  return resultOf(await request("/v1/diffs", { method: "POST", body: form, signal }));
}

/** Wait for a job and fetch its result; without a listener any more it is cancelled. */
async function finished(job: any, progress: Progress, signal: AbortSignal): Promise<Result> {
  const path = `/v1/jobs/${job.id}`;
  try {
    while (job.status === "queued" || job.status === "running") {
      progress(job.progress);
      await new Promise((done) => setTimeout(done, POLL_MS));
      job = await (await request(path, { signal })).json();
    }
    if (job.status !== "done") throw new Error(job.error?.message ?? `the job is ${job.status}`);
    const result = await resultOf(await request(`${path}/result`, { signal }));
    void request(path, { method: "DELETE" }).catch(() => {});
    return result;
  } catch (error) {
    void request(`${path}/cancel`, { method: "POST" }).catch(() => {});
    throw error;
  }
}

async function resultOf(answer: Response): Promise<Result> {
  const fileName = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "")?.[1] ?? "take";
  return { content: await answer.blob(), notes: JSON.parse(answer.headers.get("Deitalk-Notes") ?? "[]"), fileName };
}

/** A request with the key of this tab; the user is asked for one where it is needed. */
export async function request(path: string, given: RequestInit = {}): Promise<Response> {
  const key = keyOf(), headers: HeadersInit = key ? { Authorization: `Bearer ${key}` } : {};
  const answer = await fetch(path, { ...given, headers }).catch(() => {
    throw new Error("the service does not answer; is it still running?");
  });
  if (answer.ok) return answer;
  if (answer.status === 401 && (await askKey())) return request(path, given);
  const problem = await answer.json().catch(() => undefined);
  throw new Error(problem?.message ?? `the service answers ${answer.status}`);
}

/** The key that was given in this tab. */
export function keyOf(): string | null {
  return sessionStorage.getItem(KEY);
}

async function askKey(): Promise<boolean> {
  const dialog = $<HTMLDialogElement>("key-dialog"), field = $<HTMLInputElement>("key");
  dialog.returnValue = "";
  field.value = "";
  dialog.showModal();
  await new Promise((done) => dialog.addEventListener("close", done, { once: true }));
  if (dialog.returnValue !== "ok" || !field.value.trim()) return false;
  sessionStorage.setItem(KEY, field.value.trim());
  return true;
}
