/** The microphone straight to the face: samples to `/v1/live`, its frames at the pace of the sound. */

import { $, messageOf, notice } from "../dom";
import type { Player } from "../player";
import { openMicrophone } from "./microphone";
import { keyOf, request } from "./service";

const BLOCK_SAMPLES = 2048;
/** Bytes of index, lateness and time before the values of a record. */
const HEAD_BYTES = 16;
/** Where more sound than this waits to be shown, all but a part is skipped, seconds. */
const MOST_WAITING = 0.8, KEPT_WAITING = 0.4;

interface Frame {
  time: number;
  late: number;
  values: Float32Array;
  /** Turn and shift of the head, where the service sends it. */
  head?: Float32Array;
}

export class Live {
  private socket?: WebSocket;
  private stream?: MediaStream;
  private context?: AudioContext;
  private names: string[] = [];
  /** Numbers of a frame's head track. */
  private headSize = 0;
  private frames: Frame[] = [];
  /** Seconds of the page's clock at which the shown sound begins; unknown while no frame waits. */
  private began?: number;

  constructor(private readonly player: Player, private readonly emotion: () => string) {
    $("live").addEventListener("click", () => (this.socket ? this.stop() : void this.start()));
  }

  get isOn(): boolean {
    return this.socket !== undefined;
  }

  /** Change the emotion of what is said from now on. */
  setEmotion(emotion: string): void {
    this.send({ type: "set", emotion });
  }

  stop(): void {
    this.send({ type: "stop" });
    this.close();
  }

  private async start(): Promise<void> {
    this.player.transport.pause();
    try {
      this.stream = await openMicrophone(true);
    } catch (error) {
      return notice(`the microphone cannot be used: ${messageOf(error)}`);
    }
    this.context = new AudioContext();
    this.open(this.context.sampleRate);
  }

  private open(rate: number): void {
    const key = keyOf(), protocols = key ? ["deitalk", `deitalk.key.${key}`] : [];
    const socket = (this.socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/v1/live`, protocols));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.send({ type: "start", sample_rate: Math.round(rate), encoding: "float32", frames: "binary", emotion: this.emotion(), head: true });
      this.listen();
      this.draw();
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.message(JSON.parse(data)) : this.receive(data));
    socket.onclose = ({ wasClean }) => {
      if (socket !== this.socket) return;
      this.close();
      if (!wasClean) void this.explain();
    };
    this.label(true);
  }

  /** Why a connection was refused or cut; the user is asked for a key where one is needed. */
  private async explain(): Promise<void> {
    try {
      await request("/v1/emotions");
      notice("the service does not take live sound now");
    } catch (error) {
      notice(messageOf(error));
    }
  }

  /** Send every block of the microphone; nothing is played. */
  private listen(): void {
    const source = this.context!.createMediaStreamSource(this.stream!);
    const blocks = this.context!.createScriptProcessor(BLOCK_SAMPLES, 1, 1);
    blocks.onaudioprocess = ({ inputBuffer }) => {
      if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(inputBuffer.getChannelData(0).slice());
    };
    source.connect(blocks).connect(this.context!.destination);
  }

  private message(given: any): void {
    if (given.type === "header") {
      this.names = given.names;
      this.headSize = given.head.length;
    }
    if (given.type === "problem") notice(given.message);
  }

  private receive(data: ArrayBuffer): void {
    const view = new DataView(data), { length } = this.names, count = length + this.headSize;
    const size = HEAD_BYTES + 4 * count;
    for (let at = 0; at + size <= data.byteLength; at += size) {
      const row = Float32Array.from({ length: count }, (_, k) => view.getFloat32(at + HEAD_BYTES + 4 * k, true));
      const values = row.subarray(0, length), head = this.headSize ? row.subarray(length) : undefined;
      this.frames.push({ time: view.getFloat64(at + 8, true), late: view.getFloat32(at + 4, true), values, head });
    }
  }

  /** Show frames at the pace at which they were spoken; wait where there is none, skip where there are many. */
  private draw = (): void => {
    if (!this.socket) return;
    const now = performance.now() / 1000, { frames } = this;
    if (frames.length) {
      const first = frames[0].time, last = frames[frames.length - 1].time;
      if (this.began === undefined) this.began = now - first;
      if (last - (now - this.began) > MOST_WAITING) this.began = now - last + KEPT_WAITING;
      let shown: Frame | undefined;
      while (frames.length && frames[0].time <= now - this.began) shown = frames.shift();
      if (shown) this.show(shown);
      if (!frames.length) this.began = undefined;
    }
    requestAnimationFrame(this.draw);
  };

  private show({ values, head, late }: Frame): void {
    const { board } = this.player, row = Float32Array.from(board.rest);
    this.names.forEach((name, k) => {
      const place = board.controls.indexOf(name);
      if (place >= 0) row[place] = values[k];
    });
    this.player.showLive(row, head);
    $("recorded").textContent = `${late.toFixed(1)} s late`;
  }

  private send(message: object): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  private close(): void {
    const { socket } = this;
    this.socket = undefined;
    socket?.close();
    this.stream?.getTracks().forEach((track) => track.stop());
    void this.context?.close();
    this.stream = this.context = undefined;
    this.frames = [];
    this.began = undefined;
    this.label(false);
    this.player.showLive();
  }

  private label(on: boolean): void {
    const button = $("live");
    button.textContent = on ? "Stop live" : "Live";
    button.setAttribute("aria-pressed", String(on));
    $<HTMLButtonElement>("record").disabled = on;
    if (!on) $("recorded").textContent = "";
  }
}
