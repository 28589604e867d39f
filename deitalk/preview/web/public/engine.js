/** Worker of a page without a service: runs the model of the folder by ONNX Runtime. */

import * as ort from "./ort.wasm.bundle.min.mjs";

/** Content of a file beside the page; a server may have unpacked it already. */
async function content(name) {
  const answer = await fetch(new URL(name, import.meta.url));
  if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
  const bytes = new Uint8Array(await answer.arrayBuffer());
  if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) return bytes;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function start() {
  ort.env.wasm.numThreads = 1;
  const [wasm, model] = await Promise.all([content("ort-wasm-simd-threaded.wasm.gz"), content("model.onnx.gz")]);
  ort.env.wasm.wasmBinary = wasm.buffer;
  return ort.InferenceSession.create(model, { executionProviders: ["wasm"], graphOptimizationLevel: "basic" });
}

const session = start();

onmessage = async ({ data: { number, inputs } }) => {
  try {
    const ready = await session, began = performance.now();
    const feeds = Object.fromEntries(Object.entries(inputs).map(([name, { data, dims }]) => [name, new ort.Tensor("float32", data, dims)]));
    const found = await ready.run(feeds);
    const outputs = Object.fromEntries(Object.entries(found).map(([name, tensor]) => [name, tensor.data]));
    postMessage({ number, outputs, seconds: (performance.now() - began) / 1000 });
  } catch (error) {
    postMessage({ number, error: String(error?.message ?? error) });
  }
};
