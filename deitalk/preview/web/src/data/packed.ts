/** Reads the arrays packed by `deitalk.preview.page.pack`: gzip, base64, one JSON header, then the bytes in planes. */

type TypedArray = Float32Array | Uint16Array | Uint32Array | Int16Array | Uint8Array;

export type Arrays = Record<string, TypedArray>;

const KINDS = {
  float32: Float32Array,
  uint16: Uint16Array,
  uint32: Uint32Array,
  int16: Int16Array,
  uint8: Uint8Array,
} as const;

interface Header {
  facts: Record<string, unknown>;
  arrays: { name: string; kind: keyof typeof KINDS; length: number; offset: number }[];
}

export interface Packed {
  facts: Record<string, any>;
  arrays: Arrays;
}

export function base64Bytes(text: string): Uint8Array {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

export function unpack(base64: string): Promise<Packed> {
  return unpackBytes(new Blob([base64Bytes(base64) as BlobPart]));
}

export async function unpackBytes(packed: Blob): Promise<Packed> {
  const stream = packed.stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header: Header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const start = Math.ceil((4 + length) / 8) * 8;
  const arrays: Arrays = {};
  for (const { name, kind, length: count, offset } of header.arrays) {
    const array = new KINDS[kind](count), size = array.BYTES_PER_ELEMENT, own = new Uint8Array(array.buffer);
    const planes = new Uint8Array(buffer, start + offset, own.length);
    for (let plane = 0; plane < size; plane++) {
      for (let k = 0; k < count; k++) own[k * size + plane] = planes[plane * count + k];
    }
    arrays[name] = array;
  }
  return { facts: header.facts, arrays };
}
