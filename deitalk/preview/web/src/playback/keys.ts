/** Keys of the page, and which element has them. */

import { $ } from "../dom";

export const KEYS: [string, string][] = [
  ["Space", "play or pause"], [", . ← →", "one frame back, on"], ["Home End", "to the start, to the end"],
  ["L", "loop"], ["[ ]", "start, end of the loop's range"], ["- +", "slower, faster"],
  ["Z X F", "timeline: nearer, farther, all"], ["Ctrl+Z Ctrl+Y", "undo, redo"],
  ["P", "add a point of intensity"], ["↑ ↓ ← → Delete", "move, delete the point in focus"],
  ["1 2 3 4", "face, three quarter, side, mouth"], ["O", "open a file"], ["?", "this list"],
];

/** Keys that act again while they are held. */
const REPEATED = /^(Arrow\w+|[,.zx])$/i;

export const isText = (target: HTMLElement) =>
  target.tagName === "TEXTAREA" || (target.tagName === "INPUT" && !/^(checkbox|range|button)$/.test((target as HTMLInputElement).type));

/** Whether an element that has the focus uses a key itself. */
function ownKeys(target: HTMLElement, key: string): boolean {
  if (isText(target)) return true;
  if (key === " ") return /^(BUTTON|SUMMARY|INPUT)$/.test(target.tagName);
  return /^(SELECT|INPUT)$/.test(target.tagName) && /^(Arrow|Home|End)/.test(key);
}

export function bindKeys(actions: Record<string, () => void>): void {
  addEventListener("keydown", (event) => {
    const isOrder = (event.ctrlKey || event.metaKey || event.altKey) && !event.getModifierState("AltGraph");
    if (isOrder || document.querySelector("dialog[open]")) return;
    if (ownKeys(event.target as HTMLElement, event.key)) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    if (!event.repeat || REPEATED.test(event.key)) action();
  });
}

/** A control that was clicked gives the keys back to playback; one reached by Tab keeps its own. */
export function bindFocus(): void {
  let byPointer = false;
  addEventListener("pointerdown", () => (byPointer = true), true);
  addEventListener("keydown", () => (byPointer = false), true);
  const release = (event: Event) => {
    const target = event.target as HTMLElement;
    if (byPointer && !isText(target)) (target.closest("button, select, input, summary") as HTMLElement)?.blur();
  };
  addEventListener("click", (event) => (event.target as HTMLElement).tagName !== "SELECT" && release(event));
  addEventListener("change", release);
}

export function listKeys(): void {
  const dialog = $<HTMLDialogElement>("help");
  $("help-button").addEventListener("click", () => dialog.showModal());
  for (const [key, what] of KEYS) {
    const term = document.createElement("dt"), meaning = document.createElement("dd");
    const cap = document.createElement("kbd");
    cap.textContent = key;
    meaning.textContent = what;
    term.append(cap);
    $("keys-list").append(term, meaning);
  }
}
