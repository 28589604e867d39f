import { copyFileSync } from "node:fs";
import { defineConfig } from "vite";
import { viteSingleFile } from "vite-plugin-singlefile";

/** Files of ONNX Runtime for `deitalk export web`, beside the page. */
const RUNTIME = ["ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm"];
const copyRuntime = {
  name: "copy-runtime",
  closeBundle: () => RUNTIME.forEach((name) => copyFileSync(`node_modules/onnxruntime-web/dist/${name}`, `../app/${name}`)),
};

export default defineConfig({
  plugins: [viteSingleFile({ removeViteModuleLoader: true }), copyRuntime],
  build: { outDir: "../app", emptyOutDir: true, target: "es2022" },
});
