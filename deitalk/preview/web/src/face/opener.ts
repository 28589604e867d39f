/** Opens a GLB and adds it to the faces. */

import { readGlb } from "./glb";
import { Model } from "./model";
import { $, button, messageOf, notice } from "../dom";

export class Opener {
  model?: Model;
  private figure?: HTMLElement;
  /** The file opened last; an earlier one that is still being read is dropped. */
  private latest?: File;

  constructor(private readonly changed: () => void) {}

  async open(file: File): Promise<void> {
    this.latest = file;
    notice(`Opening ${file.name} …`);
    try {
      const gltf = await readGlb(file);
      if (this.latest !== file) return;
      this.place(file.name, new Model(gltf));
      notice("");
    } catch (error) {
      if (this.latest === file) notice(messageOf(error));
    }
  }

  close(): void {
    this.model?.dispose();
    this.figure?.remove();
    this.model = this.figure = undefined;
    this.changed();
  }

  private place(name: string, model: Model): void {
    this.model?.dispose();
    this.figure?.remove();
    this.model = model;
    this.figure = document.createElement("figure");
    this.figure.className = "model";
    const caption = document.createElement("figcaption");
    const length = model.seconds ? `${model.seconds.toFixed(2)} s of animation` : "no animation";
    caption.append(`${name}: ${model.shapes.length} shapes, ${length} `, button("Close", () => this.close()));
    model.canvas.setAttribute("role", "img");
    model.canvas.setAttribute("aria-label", `${name}; drag to turn`);
    this.figure.append(model.canvas, caption);
    if (!model.seconds && model.shapes.length) this.figure.append(sliders(model));
    $("faces").append(this.figure);
    this.changed();
  }
}

/** A slider for every shape. */
function sliders(model: Model): HTMLElement {
  const box = document.createElement("details");
  box.open = true;
  box.append(Object.assign(document.createElement("summary"), { textContent: "Shapes" }));
  const list = document.createElement("div");
  list.className = "sliders";
  for (const name of model.shapes) {
    const label = document.createElement("label"), slider = document.createElement("input");
    Object.assign(slider, { type: "range", min: "0", max: "1", step: "0.01", value: String(model.weight(name)) });
    slider.addEventListener("input", () => model.setShape(name, Number(slider.value)));
    label.append(Object.assign(document.createElement("span"), { textContent: name, title: name }), slider);
    list.append(label);
  }
  box.append(list);
  return box;
}
