/** The faces of takes, side by side or the second laid over the first up to a wipe. */

import type { Packed } from "../data/packed";
import { $, button } from "../dom";
import { Face } from "./face";

export interface Caption {
  title: string;
  /** Makes the caption a button. */
  choose?: () => void;
}

export class Faces {
  private readonly shown: { face: Face; figure: HTMLElement; caption: HTMLElement }[] = [];
  private view = "face";

  constructor(private readonly box: HTMLElement, private readonly head: Packed) {
    $("wipe").addEventListener("click", () => this.setWipe(!this.isWipe));
    $("wipe-at").addEventListener("input", () => this.placeWipe());
    this.set([]);
  }

  get rig() {
    return this.shown[0]?.face.rig;
  }

  get isWipe(): boolean {
    return this.box.classList.contains("wipe");
  }

  /** Have one face for each caption. */
  set(captions: Caption[]): void {
    while (this.shown.length > captions.length) {
      const { face, figure } = this.shown.pop()!;
      face.dispose();
      figure.remove();
    }
    while (this.shown.length < captions.length) this.add();
    captions.forEach(({ title, choose }, k) => {
      const { caption, face } = this.shown[k];
      caption.replaceChildren(choose ? button(title, choose) : title);
      face.canvas.setAttribute("aria-label", `Face of ${title}; drag to turn`);
    });
    $("wiping").hidden = captions.length !== 2;
    if (captions.length !== 2) this.setWipe(false);
    this.placeWipe();
  }

  /** Draw the controls of each face, and the turn of its head where it is known. */
  show(values: Float32Array[], heads: (Float32Array | undefined)[] = []): void {
    values.forEach((row, k) => this.shown[k]?.face.show(row, heads[k]));
  }

  look(view: string): void {
    this.view = view;
    this.shown.forEach(({ face }) => face.look(view));
  }

  resize(): void {
    this.shown.forEach(({ face }) => face.resize());
  }

  private add(): void {
    const face = new Face(this.head), figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    face.canvas.setAttribute("role", "img");
    face.turned = () => this.shown.forEach((other) => other.face !== face && other.face.follow(face));
    figure.append(face.canvas, caption);
    const last = this.shown[this.shown.length - 1];
    if (last) last.figure.after(figure);
    else this.box.prepend(figure);
    this.shown.push({ face, figure, caption });
    face.look(this.view);
  }

  private setWipe(on: boolean): void {
    this.box.classList.toggle("wipe", on);
    $("wipe").setAttribute("aria-pressed", String(on));
    $("wipe-at").hidden = !on;
    this.placeWipe();
    this.resize();
  }

  /** The second face from a share of the width on. */
  private placeWipe(): void {
    const second = this.shown[1]?.figure;
    if (!second) return;
    const share = Number($<HTMLInputElement>("wipe-at").value);
    second.style.clipPath = this.isWipe ? `inset(0 0 0 ${share}%)` : "";
    this.box.style.setProperty("--wipe", `${share}%`);
  }
}
