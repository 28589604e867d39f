/** Layers of edits by hand, as `rig.curves.layers` applies them: `.edit.json` files. */

import type { Board } from "./board";

export const SCHEMA = "deitalk.edit/1";
/** Seconds by which a frame may lie outside of a span. */
const SLACK = 1e-3;
const HEAD = ["head.yaw", "head.pitch", "head.roll", "head.x", "head.y", "head.z"];
const MODES = ["offset", "scale", "own"];

/** A key: time, value, and slopes before and after it, per second; without slopes they are 0. */
export type Key = readonly number[];

export interface LayerEdit {
  readonly target: string;
  readonly mode?: string;
  readonly span?: readonly [number, number];
  readonly ease?: readonly [number, number];
  readonly keys: readonly Key[];
  readonly owns?: boolean;
  readonly words?: string;
}

/** With what it was made on, which stays as it is. */
export interface Layer {
  readonly schema: string;
  readonly name?: string;
  readonly muted?: boolean;
  readonly edits: readonly LayerEdit[];
  readonly [other: string]: unknown;
}

/** Layers of a file, or of a list of them. */
export function parseLayers(text: string, name = ""): Layer[] {
  const tree = JSON.parse(text), layers: any[] = Array.isArray(tree) ? tree : [tree];
  for (const layer of layers) {
    const isKnown = layer?.schema === SCHEMA && Array.isArray(layer.edits) && layer.edits.every(isEdit);
    if (!isKnown) throw new Error(`it is no layer of edits (schema ${SCHEMA})`);
  }
  const own = name.replace(/(\.edit)?\.json$/i, "");
  return layers.map((layer) => (layer.name || !own ? layer : { ...layer, name: own }));
}

function isEdit(edit: any): boolean {
  const isKey = (key: any, k: number, all: any[]) =>
    Array.isArray(key) && (key.length === 2 || key.length === 4) && key.every(Number.isFinite) && key[0] >= 0 && (!k || key[0] > all[k - 1][0]);
  return typeof edit?.target === "string" && MODES.includes(edit.mode ?? "offset") && edit.keys?.length > 0 && edit.keys.every(isKey);
}

export function spanOf(edit: LayerEdit): readonly [number, number] {
  return edit.span ?? [edit.keys[0][0], edit.keys[edit.keys.length - 1][0]];
}

/** The edit with other keys; its span goes on from the first to the last key, or stays where it has one of its own. */
export function withKeys(edit: LayerEdit, keys: readonly Key[]): LayerEdit {
  const ends = (of: readonly Key[]) => [of[0]?.[0] ?? 0, of[of.length - 1]?.[0] ?? 0] as const;
  const [first, last] = ends(keys), [was, till] = ends(edit.keys), own = edit.span ?? [was, till];
  const isOwn = edit.keys.length > 0 && keys.length > 0 && (own[0] !== was || own[1] !== till);
  return { ...edit, keys, span: isOwn ? [Math.min(own[0], first), Math.max(own[1], last)] : [first, last] };
}

/** Cubic between keys, constant beyond them. */
export function curveAt(edit: LayerEdit, time: number): number {
  const { keys } = edit, last = keys[keys.length - 1];
  if (time <= keys[0][0]) return keys[0][1];
  if (time >= last[0]) return last[1];
  const after = keys.findIndex((key) => key[0] > time), a = keys[after - 1], b = keys[after];
  const gap = b[0] - a[0], t = (time - a[0]) / gap, leave = a[3] ?? 0, arrive = b[2] ?? 0;
  return a[1] + t * t * (3 - 2 * t) * (b[1] - a[1]) + gap * (t * (1 - t) ** 2 * leave - t * t * (1 - t) * arrive);
}

/** Slope of the curve, per second. */
export function slopeAt({ keys }: LayerEdit, time: number): number {
  const after = keys.findIndex((key) => key[0] > time);
  if (after < 1) return 0;
  const a = keys[after - 1], b = keys[after], gap = b[0] - a[0], t = (time - a[0]) / gap;
  return 6 * t * (1 - t) * (b[1] - a[1]) / gap + (1 - t) * (1 - 3 * t) * (a[3] ?? 0) - t * (2 - 3 * t) * (b[2] ?? 0);
}

export function weightAt(edit: LayerEdit, time: number): number {
  const [start, end] = spanOf(edit), [rise, fall] = edit.ease ?? [0, 0];
  if (time < start - SLACK || time > end + SLACK) return 0;
  return smooth(rise > 0 ? (time - start) / rise : 1) * smooth(fall > 0 ? (end - time) / fall : 1);
}

function smooth(share: number): number {
  const t = Math.min(Math.max(share, 0), 1);
  return t * t * (3 - 2 * t);
}

function changed(edit: LayerEdit, time: number, weight: number, value: number, rest: number): number {
  const curve = curveAt(edit, time);
  if (edit.mode === "scale") return rest + (value - rest) * (1 + weight * (curve - 1));
  return edit.mode === "own" ? value + weight * (curve - value) : value + weight * curve;
}

/** Columns of a control, or of the members of a set. */
export function columnsOf(board: Board, target: string): number[] {
  const column = board.controls.indexOf(target);
  return board.sets?.[target] ?? (column < 0 ? [] : [column]);
}

/** Edits that change a time. */
function editsAt(layers: readonly Layer[], time: number): LayerEdit[] {
  return layers.filter((layer) => !layer.muted).flatMap((layer) => layer.edits).filter((edit) => weightAt(edit, time) > 0);
}

/** The controls of a frame with layers: lips that meet before meet again, ranges hold. */
export function withLayers(row: Float32Array, time: number, layers: readonly Layer[], board: Board, meet = true): Float32Array {
  const edits = editsAt(layers, time);
  if (!edits.length) return row;
  const out = Float64Array.from(row), owned = new Set<number>(), touched = new Set<number>();
  for (const edit of edits) {
    const weight = weightAt(edit, time);
    for (const c of columnsOf(board, edit.target)) {
      out[c] = changed(edit, time, weight, out[c], board.rest[c]);
      touched.add(c);
      if (edit.owns || edit.mode === "own") owned.add(c);
    }
  }
  const { closures } = board, closed = closures && meet ? closedIn(row, closures) : 0;
  const result = row.slice();
  for (const c of touched) {
    const change = out[c] - row[c];
    if (!change) continue;
    if (closed && !owned.has(c)) {
      if (closures!.seals.some((kind) => kind.includes(c))) out[c] -= closed * Math.min(change, 0);
      else if (closures!.opening.includes(c)) out[c] -= closed * change;
    }
    result[c] = Math.min(Math.max(out[c], board.minimum[c]), board.maximum[c]);
  }
  return result;
}

function closedIn(row: Float32Array, closures: NonNullable<Board["closures"]>): number {
  const means = closures.seals.filter((kind) => kind.length).map((kind) => kind.reduce((sum, c) => sum + row[c], 0) / kind.length);
  return means.length ? smooth((Math.max(...means) - closures.begin) / (closures.full - closures.begin)) : 0;
}

/** Turn and shift of the head with layers. */
export function headWithLayers(head: Float32Array, time: number, layers: readonly Layer[]): Float32Array {
  const out = head.slice();
  for (const edit of editsAt(layers, time)) {
    const place = HEAD.indexOf(edit.target);
    if (place >= 0) out[place] = changed(edit, time, weightAt(edit, time), out[place], 0);
  }
  return out;
}

/** The file of layers: one as itself, several as a list. */
export function layersText(layers: readonly Layer[]): string {
  return `${JSON.stringify(layers.length === 1 ? layers[0] : layers, null, 1)}\n`;
}
