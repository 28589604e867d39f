/** Worker of a page without a service: runs the models of the folder by ONNX Runtime. */

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

/** Content of a model, whose even bytes come first. */
async function joined(name) {
  const planes = await content(`${name}.planes.gz`), bytes = new Uint8Array(planes.length), odd = (planes.length + 1) >> 1;
  for (let k = 0; k < odd; k++) bytes[2 * k] = planes[k];
  for (let k = odd; k < planes.length; k++) bytes[2 * (k - odd) + 1] = planes[k];
  return bytes;
}

async function begin() {
  ort.env.wasm.numThreads = 1;
  ort.env.wasm.wasmBinary = (await content("ort-wasm-simd-threaded.wasm.gz")).buffer;
}

const runtime = begin();

/** Session of "model", or of "live", whose file has only the weights that the other one lacks. */
async function open(name) {
  const names = name === "live" ? ["live.onnx", "model.onnx"] : ["model.onnx"];
  const [model, weights] = await Promise.all([...names.map(joined), runtime]);
  const options = { executionProviders: ["wasm"], graphOptimizationLevel: "basic" };
  if (name === "live") options.externalData = [{ path: "model.onnx", data: weights }];
  return ort.InferenceSession.create(model, options);
}

const sessions = { model: open("model") };
/** State of the live voice, from one run to the next. */
let state;

onmessage = async ({ data: { number, model, inputs } }) => {
  try {
    const ready = await (sessions[model] ??= open(model)), began = performance.now();
    const feeds = Object.fromEntries(Object.entries(inputs).map(([name, { data, dims }]) => [name, new ort.Tensor("float32", data, dims)]));
    if (model === "live") feeds.state ??= state;
    const found = await ready.run(feeds);
    if (model === "live") {
      state = found.next_state;
      delete found.next_state;
    }
    const outputs = Object.fromEntries(Object.entries(found).map(([name, tensor]) => [name, tensor.data]));
    postMessage({ number, outputs, seconds: (performance.now() - began) / 1000 });
  } catch (error) {
    postMessage({ number, error: String(error?.message ?? error) });
  }
};
