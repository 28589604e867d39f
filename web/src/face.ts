/** Draws one head with three.js, with the light that Python draws it with. */

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import type { Packed } from "./data";
import { Rig } from "./rig";

const es = (source: string) => source.replace("#version 330\n", "precision highp float;\n");

/** Whether WebGL is drawn by the processor (SwiftShader, llvmpipe). */
function isSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl!.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

export class Face {
  readonly rig: Rig;
  private scale: number;
  readonly canvas = document.createElement("canvas");
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(20, 1, 15, 140);
  private readonly orbit: OrbitControls;
  private readonly geometry = new THREE.BufferGeometry();
  private readonly material: THREE.RawShaderMaterial;
  private readonly faces: Uint16Array;
  private readonly views: Record<string, { target: number[]; position: number[]; degrees: number }>;

  constructor(head: Packed) {
    this.rig = new Rig(head);
    this.views = head.facts.views;
    this.faces = head.arrays.faces as Uint16Array;
    const hasGpu = !isSoftware();
    this.scale = hasGpu ? 1 : 0.6;
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: hasGpu });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    const { shaders } = head.facts;
    this.material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: es(shaders.vertex),
      fragmentShader: es(shaders.fragment),
      uniforms: { view: { value: new THREE.Matrix4() }, eye: { value: new THREE.Vector3() } },
    });
    const position = new THREE.BufferAttribute(this.rig.vertices, 3);
    position.setUsage(THREE.DynamicDrawUsage);
    const normal = new THREE.BufferAttribute(new Float32Array(this.rig.vertices.length), 3);
    normal.setUsage(THREE.DynamicDrawUsage);
    this.geometry.setAttribute("position", position);
    this.geometry.setAttribute("normal", normal);
    this.geometry.setAttribute("paint", new THREE.BufferAttribute(head.arrays.paint as Uint8Array, 4, true));
    this.geometry.setIndex(new THREE.BufferAttribute(this.faces, 1));
    const mesh = new THREE.Mesh(this.geometry, this.material);
    mesh.frustumCulled = false;
    this.scene.add(this.sky(shaders), mesh);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.addEventListener("change", () => this.draw());
    this.look("face");
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
    this.camera.fov = degrees;
    this.camera.position.set(position[0], position[1], position[2]);
    this.orbit.target.set(target[0], target[1], target[2]);
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.draw();
  }

  resize(): void {
    const box = this.canvas.getBoundingClientRect();
    if (!box.width) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * (this.sharp ? 1.5 : this.scale));
    this.renderer.setSize(box.width, box.height, false);
    this.camera.aspect = box.width / box.height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  show(values: ArrayLike<number>): void {
    this.adapt();
    this.rig.pose(values);
    this.normals();
    this.geometry.attributes.position.needsUpdate = true;
    this.geometry.attributes.normal.needsUpdate = true;
    if (this.sharp) this.sharpen(false);
    this.draw();
    clearTimeout(this.idle);
    if (this.scale < 1) this.idle = window.setTimeout(() => this.sharpen(true), 300);
  }

  private idle = 0;
  private sharp = false;

  /** A still face is drawn with all its pixels, however slow that is. */
  private sharpen(on: boolean): void {
    this.sharp = on;
    this.resize();
  }

  private shownAt = 0;
  private slow = 0;

  /** Draw fewer pixels where frames take long, as without a GPU. */
  private adapt(): void {
    const now = performance.now(), took = now - this.shownAt;
    this.shownAt = now;
    if (took > 400) return;
    this.slow = took > 70 ? this.slow + 1 : 0;
    if (this.slow < 6 || this.scale <= 0.45) return;
    this.slow = 0;
    this.scale *= 0.75;
    this.resize();
  }

  private draw(): void {
    const { view, eye } = this.material.uniforms;
    this.camera.updateMatrixWorld();
    view.value.multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
    eye.value.copy(this.camera.position);
    this.renderer.render(this.scene, this.camera);
  }

  /** Area-weighted vertex normals, unnormalised: the shader normalises them. */
  private normals(): void {
    const v = this.rig.vertices;
    const n = this.geometry.attributes.normal.array as Float32Array;
    n.fill(0);
    for (let f = 0; f < this.faces.length; f += 3) {
      const a = 3 * this.faces[f], b = 3 * this.faces[f + 1], c = 3 * this.faces[f + 2];
      const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
      const wx = v[c] - v[a], wy = v[c + 1] - v[a + 1], wz = v[c + 2] - v[a + 2];
      const x = uy * wz - uz * wy, y = uz * wx - ux * wz, z = ux * wy - uy * wx;
      for (const k of [a, b, c]) {
        n[k] += x;
        n[k + 1] += y;
        n[k + 2] += z;
      }
    }
    for (let k = 0; k < n.length; k += 3) {
      const length = Math.hypot(n[k], n[k + 1], n[k + 2]) || 1;
      n[k] /= length;
      n[k + 1] /= length;
      n[k + 2] /= length;
    }
  }
}
