/** Inputs for the fields of an acting that no lane or slider edits, from their schema. */

import schema from "../data/acting.json";
import type { History } from "../data/edit";
import { $, button, showValue } from "../dom";

/** Name of a field of `deitalk.Acting`. */
export type ActingField = keyof typeof schema.properties;

interface Field {
  description: string;
  default: unknown;
  type?: string;
  minimum?: number;
  maximum?: number;
  examples?: string[];
}

export const FIELDS: Record<string, Field> = schema.properties;
/** Fields with an editor of their own. */
const EDITED: ActingField[] = ["emotion", "intensity_curve", "words", "language", "life", "gain", "edit"];
/** Fields that are files, with the ends of their names; any recording where there are none. */
const FILES: Record<string, string> = { voice: ".json", listen_to: "", after: ".zip,.csv,.json,.npz", into: ".zip,.csv,.json,.npz" };
const TYPES: Record<string, string> = { number: "number", integer: "number", boolean: "checkbox" };

/** The inputs, bound to the edits; returns what shows an edit in them. */
export function bindForm(history: History): () => void {
  const names = Object.keys(FIELDS).filter((name) => !EDITED.includes(name as ActingField));
  const shows = names.map((name) => bindField(name, FIELDS[name], history));
  return () => shows.forEach((show) => show());
}

function bindField(name: string, field: Field, history: History): () => void {
  if (name in FILES) return bindFile(name, field, history);
  const { input, caption } = inputOf(name, field, TYPES[field.type ?? ""] ?? "text");
  if (input.type === "number") Object.assign(input, { min: field.minimum, max: field.maximum, step: field.type === "integer" ? 1 : 0.01 });
  if (field.examples) input.placeholder = field.examples[0];
  caption.append(input);
  input.addEventListener("change", () => {
    if (!input.checkValidity()) return void input.reportValidity();
    const value = input.type === "checkbox" ? String(input.checked) : input.value.trim();
    set(history, name, value === String(field.default) ? "" : value);
  });
  return () => {
    const value = String(history.edit.acting?.[name] ?? field.default ?? "");
    if (input.type === "checkbox") input.checked = value === "true";
    else showValue(input, value);
  };
}

/** A file, or what a take that was dropped keeps of one; a press on × leaves it out. */
function bindFile(name: string, field: Field, history: History): () => void {
  const { input, caption } = inputOf(name, field, "file"), given = document.createElement("output");
  const drop = button("×", () => set(history, name, ""));
  input.accept = FILES[name];
  drop.setAttribute("aria-label", `No ${name.replaceAll("_", " ")}`);
  const row = document.createElement("span");
  caption.replaceWith(row);
  caption.append(input);
  row.append(caption, given, drop);
  input.addEventListener("change", () => input.files?.[0] && set(history, name, input.files[0]));
  return () => {
    const value = history.edit.acting?.[name] ?? "";
    if (value !== input.files?.[0]) input.value = "";
    given.textContent = value instanceof File ? value.name : value && "of the take";
    drop.disabled = !value;
  };
}

function inputOf(name: string, field: Field, type: string) {
  const input = document.createElement("input"), caption = document.createElement("label");
  Object.assign(input, { type, name });
  caption.title = field.description;
  caption.append(name.replaceAll("_", " "));
  $("acting").append(caption);
  return { input, caption };
}

function set(history: History, name: string, value: string | File): void {
  const { [name]: _, ...others } = history.edit.acting ?? {};
  history.change({ acting: value === "" ? others : { ...others, [name]: value } });
}
