/** The session of a tab in the browser's own database, so that a reload keeps it. */

import type { Edit } from "../data/edit";

export interface Session {
  name: string;
  recording: Blob;
  edit: Edit;
  /** The take as the service packed it. */
  packed: Blob;
  range?: [number, number];
  time: number;
}

const DATABASE = "deitalk-studio", STORE = "sessions", TAB = "deitalk-tab";
const KEPT = 5;

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

async function store(mode: IDBTransactionMode): Promise<IDBObjectStore> {
  const opening = indexedDB.open(DATABASE, 1);
  opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
  return (await promised(opening)).transaction(STORE, mode).objectStore(STORE);
}

export async function loadSession(): Promise<Session | undefined> {
  return promised((await store("readonly")).get(tabId()));
}

/** Keep the session of this tab, and the latest few of others. */
export async function saveSession(session: Session): Promise<void> {
  const sessions = await store("readwrite");
  await promised(sessions.put({ ...session, saved: Date.now() }, tabId()));
  const keys = await promised(sessions.getAllKeys()), values = await promised(sessions.getAll());
  const old = keys.map((key, k) => ({ key, saved: values[k].saved as number })).sort((a, b) => b.saved - a.saved);
  await Promise.all(old.slice(KEPT).map(({ key }) => promised(sessions.delete(key))));
}
