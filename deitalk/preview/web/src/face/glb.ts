/** Reads a GLB opened by the user: checked first, nothing fetched, errors of one line. */

import { type GLTF, GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

export const MAX_BYTES = 256e6;
/** Numbers in all accessors once they are unpacked; morph targets are kept dense. */
export const MAX_NUMBERS = 150e6;

const MAGIC = 0x46546c67, JSON_CHUNK = 0x4e4f534a;
const WIDTHS: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT2: 4, MAT3: 9, MAT4: 16 };
const COMPRESSED: Record<string, string> = {
  KHR_draco_mesh_compression: "Draco", EXT_meshopt_compression: "meshopt", KHR_meshopt_compression: "meshopt",
  KHR_texture_basisu: "KTX2 texture",
};

export async function readGlb(file: File): Promise<GLTF> {
  if (file.size > MAX_BYTES) {
    throw new Error(`${file.name} is ${Math.ceil(file.size / 1e6)} MB; at most ${MAX_BYTES / 1e6} MB can be opened`);
  }
  const data = await file.arrayBuffer();
  checkDocument(readDocument(data, file.name), file.name);
  try {
    return await new GLTFLoader().parseAsync(data, "");
  } catch (error) {
    const [line] = String((error as Error)?.message ?? error).split("\n");
    throw new Error(`${file.name} is inconsistent: ${line.slice(0, 160)}`);
  }
}

function readDocument(data: ArrayBuffer, name: string): Record<string, any> {
  const view = new DataView(data);
  if (data.byteLength < 20 || view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== 2) {
    throw new Error(`${name} is not a binary glTF 2.0 file; export it as .glb`);
  }
  const length = view.getUint32(12, true);
  if (view.getUint32(8, true) > data.byteLength || 20 + length > data.byteLength) {
    throw new Error(`${name} is cut short`);
  }
  try {
    if (view.getUint32(16, true) !== JSON_CHUNK) throw new Error();
    return Object(JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(data, 20, length))));
  } catch {
    throw new Error(`${name} has no readable JSON chunk`);
  }
}

function checkDocument(document: Record<string, any>, name: string): void {
  const list = (key: string): any[] => (Array.isArray(document[key]) ? document[key] : []);
  if (!list("meshes").length || !list("scenes").length) throw new Error(`${name} holds no mesh in a scene`);
  const isOutside = (part: any) => part?.uri !== undefined && !String(part.uri).startsWith("data:");
  if ([...list("buffers"), ...list("images")].some(isOutside)) {
    throw new Error(`${name} keeps its data in other files; export one .glb`);
  }
  const packed = list("extensionsRequired").find((extension) => extension in COMPRESSED);
  if (packed) {
    throw new Error(`${name} uses ${COMPRESSED[packed]} compression; export it again without`);
  }
  const numbers = list("accessors").reduce((sum, a) => sum + Number(a?.count) * (WIDTHS[a?.type] ?? NaN), 0);
  if (!(numbers <= MAX_NUMBERS)) {
    throw new Error(`${name} unpacks to ${numbers.toExponential(1)} numbers; at most ${MAX_NUMBERS / 1e6} million`);
  }
}
