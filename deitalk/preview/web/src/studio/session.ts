/** The session of a tab in the browser's own database, so that a reload keeps it. */

import type { Edit } from "../data/edit";
import type { Source } from "./service";

export interface Session extends Source {
  edit: Edit;
  /** The take as the service packed it, and the edit of its reading. */
  packed: Blob;
  animated: Edit;
}

/** What a page shows of its session, seconds. */
export interface View {
  range?: [number, number];
  time?: number;
}

const DATABASE = "deitalk-studio", RECORDS = "sessions", FILES = "files", TAB = "deitalk-tab", VIEW = "deitalk-view";
const PARTS = ["recording", "packed", "performance"] as const;
const KEPT = 5;

let database: Promise<IDBDatabase> | undefined;
/** Files as they were saved last: a file is written once, not at every edit. */
let written: Partial<Record<(typeof PARTS)[number], Blob>> = {};

function promised<T>(request: IDBRequest<T>): Promise<T> {
  return new Promise((done, fail) => {
    request.onsuccess = () => done(request.result);
    request.onerror = () => fail(request.error);
  });
}

async function stores(mode: IDBTransactionMode): Promise<[records: IDBObjectStore, files: IDBObjectStore]> {
  if (!database) {
    const opening = indexedDB.open(DATABASE, 1);
    opening.onupgradeneeded = () => [RECORDS, FILES].forEach((name) => opening.result.createObjectStore(name));
    database = promised(opening);
    database.then((opened) => (opened.onclose = () => (database = undefined)), () => (database = undefined));
  }
  const transaction = (await database).transaction([RECORDS, FILES], mode);
  return [transaction.objectStore(RECORDS), transaction.objectStore(FILES)];
}

/** Keep what is shown for a reload of this tab. */
export function keepView(view: View): void {
  sessionStorage.setItem(VIEW, JSON.stringify(view));
}

/** The session of this tab. A tab that was copied while its page was open, which has kept no view, gets a session of its own. */
export async function loadSession(): Promise<{ session?: Session; view: View }> {
  const id = sessionStorage.getItem(TAB), view = sessionStorage.getItem(VIEW);
  sessionStorage.removeItem(VIEW);
  if (!id || !view) sessionStorage.setItem(TAB, `${Date.now()} ${Math.random()}`);
  return { session: id ? await sessionOf(id) : undefined, view: JSON.parse(view ?? "{}") };
}

/** The session of an id; undefined without its files. */
export async function sessionOf(id: string): Promise<Session | undefined> {
  const [records, files] = await stores("readonly");
  const record = await promised(records.get(id));
  for (const part of PARTS) if (record) record[part] = await promised(files.get(`${id} ${part}`));
  return record?.recording && record.packed ? record : undefined;
}

/** Id and name of the session that was saved last. */
export async function latestSession(): Promise<{ id: string; name: string } | undefined> {
  const [records] = await stores("readonly");
  const [latest] = await listed(records);
  return latest;
}

/** Keep the session of this tab, and the latest few of others. */
export async function saveSession({ recording, packed, performance, ...record }: Session): Promise<void> {
  const [records, files] = await stores("readwrite"), id = sessionStorage.getItem(TAB)!, parts = { recording, packed, performance };
  for (const part of PARTS) if (written[part] !== parts[part]) files.put(parts[part], `${id} ${part}`);
  records.put({ ...record, saved: Date.now() }, id);
  records.transaction.commit(); // a page that is left does not wait
  await new Promise((done, fail) => {
    records.transaction.oncomplete = done;
    records.transaction.onabort = () => fail(records.transaction.error);
  });
  written = parts;
  await forget();
}

async function forget(): Promise<void> {
  const [records, files] = await stores("readwrite");
  for (const old of (await listed(records)).slice(KEPT)) {
    await promised(records.delete(old.id));
    for (const part of PARTS) await promised(files.delete(`${old.id} ${part}`));
  }
}

/** All sessions, the latest first. */
async function listed(records: IDBObjectStore): Promise<{ id: string; name: string }[]> {
  const ids = await promised(records.getAllKeys()), values = await promised(records.getAll());
  const all = ids.map((id, k) => ({ id: String(id), name: values[k].name as string, saved: values[k].saved as number }));
  return all.sort((a, b) => b.saved - a.saved);
}
