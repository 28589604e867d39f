/** Inputs for the fields of an acting that no lane or slider edits, from their schema. */

import schema from "../data/acting.json";
import type { History } from "../data/edit";
import { $, showValue } from "../dom";

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
/** Fields with an editor of their own, and those that name a take. */
const EDITED: ActingField[] = ["emotion", "intensity_curve", "words", "language", "life", "gain", "edit", "after", "into"];
const TYPES: Record<string, string> = { number: "number", integer: "number", boolean: "checkbox" };

/** The inputs, bound to the edits; returns what shows an edit in them. */
export function bindForm(history: History): () => void {
  const names = Object.keys(FIELDS).filter((name) => !EDITED.includes(name as ActingField));
  const shows = names.map((name) => bindField(name, FIELDS[name], history));
  return () => shows.forEach((show) => show());
}

function bindField(name: string, field: Field, history: History): () => void {
  const input = document.createElement("input"), label = document.createElement("label");
  const isFile = name === "voice";
  input.type = isFile ? "file" : TYPES[field.type ?? ""] ?? "text";
  input.name = name;
  if (isFile) input.accept = ".json";
  if (input.type === "number") Object.assign(input, { min: field.minimum, max: field.maximum, step: field.type === "integer" ? 1 : 0.01 });
  if (field.examples) input.placeholder = field.examples[0];
  label.title = field.description;
  label.append(name.replaceAll("_", " "), input);
  $("acting").append(label);
  input.addEventListener("change", async () => {
    if (!input.checkValidity()) return void input.reportValidity();
    const value = isFile ? (await input.files?.[0]?.text()) ?? "" : input.type === "checkbox" ? String(input.checked) : input.value.trim();
    const { [name]: _, ...others } = history.edit.acting ?? {};
    history.change({ acting: value === "" || value === String(field.default) ? others : { ...others, [name]: value } });
  });
  return () => {
    const value = history.edit.acting?.[name] ?? String(field.default ?? "");
    if (input.type === "checkbox") input.checked = value === "true";
    else if (!isFile) showValue(input, value);
    else if (!history.edit.acting?.[name]) input.value = "";
  };
}
