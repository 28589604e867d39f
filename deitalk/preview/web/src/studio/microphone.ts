/** Records the microphone; the second press of its button ends the recording. */

import { $, messageOf, notice } from "../dom";

const MOST_SECONDS = 600;

/** Open the microphone; `Record` and `Live` are disabled until the user has allowed it. */
export async function openMicrophone(noiseSuppression: boolean): Promise<MediaStream> {
  const buttons = [$<HTMLButtonElement>("record"), $<HTMLButtonElement>("live")];
  buttons.forEach((button) => (button.disabled = true));
  try {
    if (!navigator.mediaDevices) throw new Error("browsers give it to pages of https and of localhost only");
    const audio = { echoCancellation: false, noiseSuppression, autoGainControl: false };
    return await navigator.mediaDevices.getUserMedia({ audio });
  } finally {
    buttons.forEach((button) => (button.disabled = false));
  }
}

/** Call `begin` before a recording, and `done` with it. */
export function bindMicrophone(begin: () => void, done: (recording: File) => Promise<void>): void {
  const button = $("record"), shown = $("recorded");
  let recorder: MediaRecorder | undefined;
  button.addEventListener("click", () => {
    if (recorder) recorder.stop();
    else void start();
  });

  async function start(): Promise<void> {
    begin();
    try {
      const stream = await openMicrophone(false);
      record(new MediaRecorder(stream), stream);
    } catch (error) {
      notice(`the microphone cannot be used: ${messageOf(error)}`);
    }
  }

  function record(started: MediaRecorder, stream: MediaStream): void {
    const parts: Blob[] = [], began = performance.now();
    const timer = setInterval(() => {
      const seconds = (performance.now() - began) / 1000;
      shown.textContent = `${seconds.toFixed(1)} s`;
      if (seconds > MOST_SECONDS) started.stop();
    }, 100);
    started.ondataavailable = (event) => parts.push(event.data);
    started.onstop = () => {
      clearInterval(timer);
      stream.getTracks().forEach((track) => track.stop());
      recorder = undefined;
      label(false);
      void done(new File(parts, "microphone.webm", { type: started.mimeType }));
    };
    started.start();
    recorder = started;
    label(true);
  }

  function label(on: boolean): void {
    button.textContent = on ? "Stop" : "Record";
    button.setAttribute("aria-pressed", String(on));
    $<HTMLButtonElement>("live").disabled = on;
    if (!on) shown.textContent = "";
  }
}
