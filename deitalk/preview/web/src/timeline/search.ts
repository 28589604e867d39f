/** A search field that finds controls by words of their names. */

import { $, button } from "../dom";

const MOST_FOUND = 8;

/** Names that hold every word, shorter names first. */
export function findControls(names: string[], query: string): string[] {
  const words = query.toLowerCase().replace(/\bleft\b/g, "_l_").replace(/\bright\b/g, "_r_").split(/\s+/).filter(Boolean);
  if (!words.length) return [];
  const found = names.filter((name) => words.every((word) => name.toLowerCase().includes(word)));
  return found.sort((a, b) => a.length - b.length);
}

/** Call `chosen` with a control; Enter takes the first that is found. */
export function bindSearch(controls: string[], chosen: (name: string) => void): void {
  const search = $<HTMLInputElement>("search"), found = $("found");
  const choose = (name: string) => {
    chosen(name);
    search.value = "";
    found.replaceChildren();
    search.focus();
  };
  search.addEventListener("input", () => {
    const names = findControls(controls, search.value);
    found.replaceChildren(...names.slice(0, MOST_FOUND).map((name) => button(name, () => choose(name))));
    if (search.value.trim() && !names.length) found.textContent = "no control has this in its name";
    if (names.length > MOST_FOUND) found.append(`and ${names.length - MOST_FOUND} more`);
  });
  search.addEventListener("keydown", (event) => {
    const [first] = findControls(controls, search.value);
    if (event.key === "Enter" && first) choose(first);
  });
}
