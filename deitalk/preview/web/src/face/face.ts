/** Draws the embedded head with three.js and the lights of `rig.face.render`. */

import * as THREE from "three";

import type { Packed } from "../data/packed";
import { Accents } from "./accents";
import { Rig } from "./rig";
import { turnHead } from "./turn";
import { Viewport } from "./viewport";

const es = (source: string) => source.replace("#version 330\n", "precision highp float;\n");

const MAPS = ["atlas", "creases", "pores"];

export class Face extends Viewport {
  readonly rig: Rig;
  private readonly accents: Accents;
  private readonly geometry = new THREE.BufferGeometry();
  private readonly material: THREE.RawShaderMaterial;
  private readonly faces: Uint16Array;
  private readonly weld: Uint16Array;
  /** Corners of `faces` at the first vertex of each point. */
  private readonly corners: Uint16Array;
  /** First vertex and first entry of `faces` of what no control moves. */
  private readonly still: { vertex: number; face: number };
  private hasNormals = false;
  private readonly joint: number[];
  private readonly neck: Float32Array;
  private readonly views: Record<string, { target: number[]; position: number[]; degrees: number }>;

  constructor(head: Packed) {
    super();
    this.rig = new Rig(head);
    this.accents = new Accents(head, this.rig);
    this.views = head.facts.views;
    this.faces = head.arrays.faces as Uint16Array;
    this.weld = head.arrays.weld as Uint16Array;
    this.corners = this.faces.map((v) => this.weld[v]);
    const vertex = head.facts.slices.hair[0], first = this.faces.findIndex((v) => v >= vertex);
    this.still = { vertex, face: first < 0 ? this.faces.length : 3 * Math.floor(first / 3) };
    this.joint = head.facts.joint;
    this.neck = head.arrays["neck.share"] as Float32Array;
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    const { shaders } = head.facts;
    this.material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: es(shaders.vertex),
      fragmentShader: es(shaders.fragment),
      side: THREE.DoubleSide,
      uniforms: {
        view: { value: new THREE.Matrix4() },
        eye: { value: new THREE.Vector3() },
        soft: { value: false },
        ...Object.fromEntries(MAPS.map((name) => [name, { value: this.map(name, head) }])),
      },
    });
    const normals = new Float32Array(this.rig.vertices.length);
    for (const [name, array, size] of [
      ["position", this.rig.vertices, 3], ["normal", normals, 3], ["accent", this.accents.values, 1],
    ] as const) {
      this.geometry.setAttribute(name, new THREE.BufferAttribute(array, size).setUsage(THREE.DynamicDrawUsage));
    }
    for (const [name, size] of [["paint", 4], ["light", 3], ["place", 2]] as const) {
      this.geometry.setAttribute(name, new THREE.BufferAttribute(head.arrays[name], size, true));
    }
    this.geometry.setIndex(new THREE.BufferAttribute(this.faces, 1));
    this.scene.add(this.sky(shaders), this.mesh(this.geometry, this.material), this.softMesh(head));
    this.look("face");
  }

  private mesh(geometry: THREE.BufferGeometry, material: THREE.Material): THREE.Mesh {
    const mesh = new THREE.Mesh(geometry, material);
    mesh.frustumCulled = false;
    return mesh;
  }

  /** The faces of hair, brows and lashes, drawn again for what of them lets light through. */
  private softMesh(head: Packed): THREE.Mesh {
    const light = head.arrays.light as Uint8Array;
    const kinds = head.facts.softKinds as number[];
    const isSoft = (vertex: number) => kinds.includes(Math.round((light[3 * vertex + 2] / 255) * 5));
    const geometry = new THREE.BufferGeometry();
    geometry.attributes = this.geometry.attributes;
    const faces: number[] = [];
    for (let f = 0; f < this.faces.length; f += 3)
      if (isSoft(this.faces[f])) faces.push(...this.faces.subarray(f, f + 3));
    geometry.setIndex(new THREE.BufferAttribute(new Uint16Array(faces), 1));
    const material = this.material.clone();
    Object.assign(material, { transparent: true, depthWrite: false });
    material.uniforms = { ...this.material.uniforms, soft: { value: true } };
    return this.mesh(geometry, material);
  }

  /** A picture of the surface; flat until it is decoded. */
  private map(name: string, head: Packed): THREE.Texture {
    const texture: THREE.Texture = new THREE.DataTexture(new Uint8Array([128, 128, 128, 255]), 1, 1);
    texture.needsUpdate = true;
    const file = new Blob([head.arrays[`maps.${name}`] as Uint8Array<ArrayBuffer>], { type: "image/webp" });
    createImageBitmap(file, { premultiplyAlpha: "none", colorSpaceConversion: "none" }).then((picture) => {
      const { value } = this.material.uniforms[name];
      const decoded = new THREE.Texture(picture);
      decoded.flipY = false;
      decoded.wrapS = decoded.wrapT = THREE.RepeatWrapping;
      decoded.minFilter = THREE.LinearMipmapLinearFilter;
      decoded.needsUpdate = true;
      this.material.uniforms[name].value = decoded;
      value.dispose();
      this.redraw();
    });
    return texture;
  }

  private sky(shaders: Record<string, string>): THREE.Mesh {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(9), 3));
    const material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: es(shaders.skyVertex),
      fragmentShader: es(shaders.skyFragment),
      depthWrite: false,
    });
    const sky = new THREE.Mesh(geometry, material);
    sky.frustumCulled = false;
    sky.renderOrder = -1;
    return sky;
  }

  look(name: string): void {
    const { target, position, degrees } = this.views[name];
    this.aim(new THREE.Vector3(...position), new THREE.Vector3(...target), degrees);
  }

  /** Show 185 control values, and the head's turn and shift where they are known. */
  show(values: ArrayLike<number>, head?: ArrayLike<number>): void {
    this.rig.pose(values);
    this.accents.update();
    if (head) turnHead(this.rig.vertices, head, this.joint, this.neck);
    this.normals(head !== undefined);
    this.geometry.attributes.position.needsUpdate = true;
    this.geometry.attributes.normal.needsUpdate = true;
    this.geometry.attributes.accent.needsUpdate = true;
    this.redraw();
  }

  protected draw(): void {
    const { view, eye } = this.material.uniforms;
    this.camera.updateMatrixWorld();
    view.value.multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    eye.value.copy(this.camera.position);
    super.draw();
  }

  /**
   * Unit normals of the vertices, the faces' cross products summed at their corners. Hair and shirt,
   * the last parts, only turn: theirs are worked out once, and again when the head is turned.
   */
  private normals(isTurned: boolean): void {
    const v = this.rig.vertices;
    const n = this.geometry.attributes.normal.array as Float32Array;
    const isWhole = isTurned || !this.hasNormals;
    const vertices = isWhole ? n.length : 3 * this.still.vertex;
    this.hasNormals = !isTurned;
    n.fill(0, 0, vertices);
    const { corners, weld } = this;
    for (let f = 0; f < (isWhole ? corners.length : this.still.face); f += 3) {
      const a = 3 * corners[f], b = 3 * corners[f + 1], c = 3 * corners[f + 2];
      const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
      const wx = v[c] - v[a], wy = v[c + 1] - v[a + 1], wz = v[c + 2] - v[a + 2];
      const x = uy * wz - uz * wy, y = uz * wx - ux * wz, z = ux * wy - uy * wx;
      for (const k of [a, b, c]) {
        n[k] += x;
        n[k + 1] += y;
        n[k + 2] += z;
      }
    }
    for (let k = 0; k < vertices; k += 3) {
      const from = 3 * weld[k / 3];
      if (from !== k) {
        n.copyWithin(k, from, from + 3);
        continue;
      }
      const length = Math.hypot(n[k], n[k + 1], n[k + 2]) || 1;
      n[k] /= length;
      n[k + 1] /= length;
      n[k + 2] /= length;
    }
  }
}
