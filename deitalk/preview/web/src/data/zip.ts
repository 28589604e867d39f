/** Reads ZIP archives and NumPy arrays in them: the files of a take folder. */

const END = 0x06054b50, ENTRY = 0x02014b50;
const MAX_BYTES = 512e6;
const STORED = 0, DEFLATED = 8;

/** Files of an archive by their names. */
export async function unzip(data: ArrayBuffer): Promise<Map<string, Uint8Array>> {
  const view = new DataView(data), files = new Map<string, Uint8Array>();
  let end = data.byteLength - 22;
  while (end >= 0 && view.getUint32(end, true) !== END) end--;
  if (end < 0) throw new Error("it is not a ZIP archive, or it is cut short");
  let at = view.getUint32(end + 16, true), total = 0;
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    if (view.getUint32(at, true) !== ENTRY) throw new Error("its directory is damaged");
    const method = view.getUint16(at + 10, true), packed = view.getUint32(at + 20, true);
    const nameBytes = view.getUint16(at + 28, true), from = view.getUint32(at + 42, true);
    const name = new TextDecoder().decode(new Uint8Array(data, at + 46, nameBytes));
    total += view.getUint32(at + 24, true);
    if (total > MAX_BYTES) throw new Error(`it unpacks to over ${MAX_BYTES / 1e6} MB`);
    const start = from + 30 + view.getUint16(from + 26, true) + view.getUint16(from + 28, true);
    files.set(name, await inflate(new Uint8Array(data, start, packed), method, name));
    at += 46 + nameBytes + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
  return files;
}

async function inflate(bytes: Uint8Array, method: number, name: string): Promise<Uint8Array> {
  if (method === STORED) return bytes.slice();
  if (method !== DEFLATED) throw new Error(`${name} is packed by method ${method}; pack it as plain ZIP`);
  const stream = new Blob([bytes as BlobPart]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Numbers of an array of float32 or float64 in C order. */
export function readNpy(bytes: Uint8Array): Float32Array {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const isNew = bytes[6] >= 2, length = isNew ? view.getUint32(8, true) : view.getUint16(8, true);
  const start = (isNew ? 12 : 10) + length;
  const header = new TextDecoder().decode(bytes.subarray(isNew ? 12 : 10, start));
  const data = bytes.slice(start).buffer;
  if (/fortran_order': True/.test(header)) throw new Error("its arrays are not in C order");
  if (/'<f4'/.test(header)) return new Float32Array(data);
  if (/'<f8'/.test(header)) return Float32Array.from(new Float64Array(data));
  throw new Error("its arrays are neither float32 nor float64");
}
