/** A live voice of the service: samples to `/v1/live`, its frames back. */

import type { Board } from "../data/board";
import { messageOf, notice } from "../dom";
import type { Listener, Voice } from "./live";
import { keyOf, request } from "./service";

/** Bytes of index, lateness and time before the values of a record. */
const HEAD_BYTES = 16;

export class SocketVoice implements Voice {
  private readonly socket: WebSocket;
  private names: string[] = [];
  /** Numbers of a frame's head track. */
  private headSize = 0;
  private isStopped = false;

  constructor(private readonly board: Board, rate: number, emotion: string, private readonly listener: Listener) {
    const key = keyOf(), protocols = key ? ["deitalk", `deitalk.key.${key}`] : [];
    this.socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/v1/live`, protocols);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.send({ type: "start", sample_rate: Math.round(rate), encoding: "float32", frames: "binary", emotion, head: true });
      listener.ready();
    };
    this.socket.onmessage = ({ data }) => (typeof data === "string" ? this.message(JSON.parse(data)) : this.receive(data));
    this.socket.onclose = ({ wasClean }) => {
      if (this.isStopped) return;
      listener.ended();
      if (!wasClean) void explain();
    };
  }

  feed(samples: Float32Array): void {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(samples as Float32Array<ArrayBuffer>);
  }

  setEmotion(emotion: string): void {
    this.send({ type: "set", emotion });
  }

  stop(): void {
    this.isStopped = true;
    this.send({ type: "stop" });
    this.socket.close();
  }

  private message(given: any): void {
    if (given.type === "header") {
      this.names = given.names;
      this.headSize = given.head.length;
    }
    if (given.type === "problem") notice(given.message);
  }

  private receive(data: ArrayBuffer): void {
    const view = new DataView(data), { board } = this, { length } = this.names, count = length + this.headSize;
    const size = HEAD_BYTES + 4 * count;
    for (let at = 0; at + size <= data.byteLength; at += size) {
      const row = Float32Array.from({ length: count }, (_, k) => view.getFloat32(at + HEAD_BYTES + 4 * k, true));
      const values = Float32Array.from(board.rest), head = this.headSize ? row.subarray(length) : undefined;
      this.names.forEach((name, k) => {
        const place = board.controls.indexOf(name);
        if (place >= 0) values[place] = row[k];
      });
      this.listener.frame({ time: view.getFloat64(at + 8, true), late: view.getFloat32(at + 4, true), values, head });
    }
  }

  private send(message: object): void {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}

/** Why a connection was refused or cut; the user is asked for a key where one is needed. */
async function explain(): Promise<void> {
  try {
    await request("/v1/emotions");
    notice("the service does not take live sound now");
  } catch (error) {
    notice(messageOf(error));
  }
}
