// Curves of `WS /v1/live` for a recording, while it is sent. The page is served from the service's own
// address, or from one of its `origins`.
//
//   const { names, frames: all } = await frames(url, await samples(file), { key, onFrame });
const RATE = 16000, CHUNK = RATE / 10;

// Samples of an audio file that the browser can decode: 16 kHz, mono, as 32-bit floats.
async function samples(file) {
  const sound = await new OfflineAudioContext(1, 1, RATE).decodeAudioData(await file.arrayBuffer());
  const mono = new Float32Array(sound.length);
  for (let c = 0; c < sound.numberOfChannels; c++)
    sound.getChannelData(c).forEach((value, k) => (mono[k] += value / sound.numberOfChannels));
  return mono;
}

// At the pace of speech, or with `fast` as quickly as the service takes the sound.
function frames(url, sound, { key = "", fast = false, onFrame = () => {} } = {}) {
  return new Promise((resolve, reject) => {
    const live = new WebSocket(url, key ? ["deitalk", `deitalk.key.${key}`] : []);
    const given = [], pause = (ms) => new Promise((go) => setTimeout(go, ms));
    let names;
    async function send() {
      const began = performance.now();
      for (let at = 0; at < sound.length && live.readyState === WebSocket.OPEN; at += CHUNK) {
        live.send(sound.slice(at, at + CHUNK));
        while (live.bufferedAmount > 16 * CHUNK) await pause(10);
        if (!fast) await pause(began + ((at + CHUNK) / RATE) * 1000 - performance.now());
      }
      if (live.readyState === WebSocket.OPEN) live.send(JSON.stringify({ type: "stop" }));
    }
    live.binaryType = "arraybuffer";
    live.onopen = () => live.send(JSON.stringify({ type: "start", sample_rate: RATE, encoding: "float32" }));
    live.onclose = ({ code }) => reject(new Error(`closed with code ${code}`)); // nothing after the end
    live.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        const size = 16 + 4 * names.length; // uint32 index, float32 late, float64 time, float32 values
        for (let at = 0; at < data.byteLength; at += size) {
          const time = new DataView(data).getFloat64(at + 8, true);
          given.push({ time, values: new Float32Array(data.slice(at + 16, at + size)) });
          onFrame(given.at(-1));
        }
        return;
      }
      const message = JSON.parse(data);
      if (message.type === "problem") reject(new Error(message.message));
      if (message.type === "end") resolve({ names, frames: given });
      if (message.type !== "header") return;
      names = message.names;
      send();
    };
  });
}
