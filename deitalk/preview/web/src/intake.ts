/** Files given by drop or button: GLB, curves, a take folder or its archive, a recording. */

import { $, messageOf, notice } from "./dom";

/** What the page does with each kind of file; a recording needs a service. */
export interface Intake {
  layers(text: string, name: string): void;
  glb(file: File): void;
  curves(file: File): Promise<void>;
  take(files: Map<string, Uint8Array>, name: string): Promise<void>;
  archive(file: File): Promise<void>;
  recording?(file: File): Promise<void>;
}

const CURVES = /\.(csv|json|npz|txt|tsv|xml|usd[ac]?)$/i, RECORDING = /^(audio|video)\//;
const RECORDING_NAME = /\.(wav|flac|ogg|opus|mp3|m4a|aac|aiff?|wma|webm|mp4|mov|mkv)$/i;
const MOST_FILES = 200;

export function bindIntake(intake: Intake): void {
  const input = $<HTMLInputElement>("file");
  $("open").addEventListener("click", () => input.click());
  input.addEventListener("change", () => {
    if (input.files?.[0]) void open(input.files[0], intake);
    input.value = "";
  });
  addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    document.body.classList.add("dragging");
  });
  addEventListener("dragleave", (event) => !event.relatedTarget && document.body.classList.remove("dragging"));
  addEventListener("drop", (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    document.body.classList.remove("dragging");
    const entry = event.dataTransfer.items[0]?.webkitGetAsEntry?.();
    const [file, second] = event.dataTransfer.files;
    if (second) notice("drop one file or folder; deitalk batch animates many recordings");
    else if (entry?.isDirectory) void openFolder(entry as FileSystemDirectoryEntry, intake);
    else if (file) void open(file, intake);
  });
}

async function open(file: File, intake: Intake): Promise<void> {
  try {
    if (/\.glb$/i.test(file.name)) intake.glb(file);
    else if (/\.edit\.json$/i.test(file.name)) intake.layers(await file.text(), file.name);
    else if (/\.zip$/i.test(file.name)) await intake.archive(file);
    else if (CURVES.test(file.name)) await intake.curves(file);
    else if (RECORDING.test(file.type) || RECORDING_NAME.test(file.name)) await openRecording(file, intake);
    else notice(`${file.name}: drop a recording, a take folder, curves, layers of edits or a .glb`);
  } catch (error) {
    notice(`${file.name}: ${messageOf(error)}`);
  }
}

async function openRecording(file: File, intake: Intake): Promise<void> {
  if (intake.recording) await intake.recording(file);
  else notice(`${file.name}: this page is a file; recordings are animated by deitalk serve --open`);
}

async function openFolder(folder: FileSystemDirectoryEntry, intake: Intake): Promise<void> {
  try {
    const reader = folder.createReader(), files = new Map<string, Uint8Array>();
    for (;;) {
      const entries = await new Promise<FileSystemEntry[]>((done, fail) => reader.readEntries(done, fail));
      if (!entries.length) break;
      for (const entry of entries.filter((e) => e.isFile)) {
        const file = await new Promise<File>((done, fail) => (entry as FileSystemFileEntry).file(done, fail));
        if (/\.(json|npz|wav)$|^intensity\.csv$/i.test(file.name)) files.set(file.name, new Uint8Array(await file.arrayBuffer()));
        if (files.size > MOST_FILES) throw new Error(`it holds over ${MOST_FILES} files; drop one take`);
      }
    }
    await intake.take(files, folder.name);
  } catch (error) {
    notice(`${folder.name}: ${messageOf(error)}`);
  }
}
