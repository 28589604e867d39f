// Reads binary frames of `WS /v1/live` for 16-bit samples at 16 kHz, mono. The page is served from the
// service's own address, or from one of its `origins`.
function frames(url, samples) {
  return new Promise((resolve, reject) => {
    const live = new WebSocket(url);
    const given = [];
    let names;
    live.binaryType = "arraybuffer";
    live.onopen = () => live.send(JSON.stringify({ type: "start", sample_rate: 16000 }));
    live.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        const size = 16 + 4 * names.length; // uint32 index, float32 late, float64 time, float32 values
        for (let at = 0; at < data.byteLength; at += size) {
          const time = new DataView(data).getFloat64(at + 8, true);
          given.push({ time, values: new Float32Array(data.slice(at + 16, at + size)) });
        }
        return;
      }
      const message = JSON.parse(data);
      if (message.type === "problem") reject(new Error(message.message));
      if (message.type === "end") resolve({ names, frames: given });
      if (message.type !== "header") return;
      names = message.names;
      live.send(samples);
      live.send(JSON.stringify({ type: "stop" }));
    };
  });
}
