/** Helpers for elements of the document. */

export const $ = <T extends Element = HTMLElement>(id: string) => document.getElementById(id) as unknown as T;

export function timeCode(seconds: number): string {
  const minutes = Math.floor(seconds / 60);
  return `${String(minutes).padStart(2, "0")}:${(seconds - 60 * minutes).toFixed(3).padStart(6, "0")}`;
}

/** A button with a click handler. */
export function button(label: string, action: () => void): HTMLButtonElement {
  const made = Object.assign(document.createElement("button"), { type: "button", textContent: label });
  made.addEventListener("click", action);
  return made;
}

/** Shows one line of status or error, announced by screen readers. */
export function notice(line: string): void {
  $("notice").textContent = line;
}

/** First line of an error. */
export function messageOf(error: unknown): string {
  return String((error as Error)?.message ?? error).split("\n")[0];
}

/** Gives the user a file. */
export function save(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** Shows the value of an edit in its field; text that is being typed there, and is not yet an edit, stays. */
export function showValue(field: HTMLInputElement, value: string): void {
  const isTyped = field === document.activeElement && field.value !== value && field.value !== (field.dataset.shown ?? "");
  if (!isTyped) field.value = field.dataset.shown = value;
}
