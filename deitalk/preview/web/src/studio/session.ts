/** The session of a tab in the browser's own database, so that a reload keeps it. */

import type { Edit } from "../data/edit";
import type { Source } from "./service";

export interface Session extends Source {
  edit: Edit;
  /** The take as the service packed it. */
  packed: Blob;
  range?: [number, number];
  time: number;
}

const DATABASE = "deitalk-studio", RECORDS = "sessions", FILES = "files", TAB = "deitalk-tab";
const PARTS = ["recording", "packed"] as const;
const KEPT = 5;

/** Files as they were saved last: a file is written once, not at every edit. */
const written: Partial<Record<(typeof PARTS)[number], Blob>> = {};

/** Each tab has its own session; a reload has the same tab. */
function tabId(): string {
  const id = sessionStorage.getItem(TAB) ?? crypto.randomUUID();
  sessionStorage.setItem(TAB, id);
  return id;
}

function promised<T>(request: IDBRequest<T>): Promise<T> {
  return new Promise((done, fail) => {
    request.onsuccess = () => done(request.result);
    request.onerror = () => fail(request.error);
  });
}

async function stores(mode: IDBTransactionMode): Promise<[records: IDBObjectStore, files: IDBObjectStore]> {
  const opening = indexedDB.open(DATABASE, 1);
  opening.onupgradeneeded = () => [RECORDS, FILES].forEach((name) => opening.result.createObjectStore(name));
  const transaction = (await promised(opening)).transaction([RECORDS, FILES], mode);
  return [transaction.objectStore(RECORDS), transaction.objectStore(FILES)];
}

/** The session of this tab, or of an id. */
export async function loadSession(id = tabId()): Promise<Session | undefined> {
  const [records, files] = await stores("readonly");
  const record = await promised(records.get(id));
  if (!record) return undefined;
  for (const part of PARTS) record[part] = await promised(files.get(`${id} ${part}`));
  return record;
}

/** Id and name of the session that was saved last. */
export async function latestSession(): Promise<{ id: string; name: string } | undefined> {
  const [records] = await stores("readonly");
  const [latest] = await listed(records);
  return latest;
}

/** Keep the session of this tab, and the latest few of others. */
export async function saveSession({ recording, packed, ...record }: Session): Promise<void> {
  const [records, files] = await stores("readwrite"), id = tabId();
  for (const [part, file] of [["recording", recording], ["packed", packed]] as const) {
    if (written[part] !== file) await promised(files.put(file, `${id} ${part}`));
    written[part] = file;
  }
  await promised(records.put({ ...record, saved: Date.now() }, id));
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
