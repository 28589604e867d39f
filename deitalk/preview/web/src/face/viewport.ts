/** A canvas with an orbiting camera, shared by the embedded head and an opened GLB. */

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Whether WebGL is drawn by the processor (SwiftShader, llvmpipe). */
function isSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl!.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

export abstract class Viewport {
  readonly canvas = document.createElement("canvas");
  protected readonly renderer: THREE.WebGLRenderer;
  protected readonly scene = new THREE.Scene();
  protected readonly camera = new THREE.PerspectiveCamera(20, 1, 15, 140);
  private readonly orbit: OrbitControls;
  protected readonly hasGpu = !isSoftware();
  private scale: number;
  private idle = 0;
  private isSharp = false;
  private shownAt = 0;
  private slow = 0;
  private isFollowing = false;
  /** Called when the user turns the camera. */
  turned: () => void = () => {};

  constructor() {
    this.scale = this.hasGpu ? 1 : 0.6;
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: this.hasGpu });
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.addEventListener("change", () => {
      this.draw();
      if (!this.isFollowing) this.turned();
    });
  }

  abstract look(view: string): void;

  protected aim(position: THREE.Vector3, target: THREE.Vector3, degrees: number): void {
    this.camera.fov = degrees;
    this.camera.position.copy(position);
    this.orbit.target.copy(target);
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.draw();
  }

  /** Look from the same place as another. */
  follow(other: Viewport): void {
    this.isFollowing = true;
    this.aim(other.camera.position, other.orbit.target, other.camera.fov);
    this.isFollowing = false;
  }

  resize(): void {
    const box = this.canvas.getBoundingClientRect();
    if (!box.width) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * (this.isSharp ? 1.5 : this.scale));
    this.renderer.setSize(box.width, box.height, false);
    this.camera.aspect = box.width / box.height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Draw after a change of shape: with fewer pixels if drawing is slow, with all when at rest. */
  protected redraw(): void {
    this.adapt();
    if (this.isSharp) this.sharpen(false);
    this.draw();
    clearTimeout(this.idle);
    if (this.scale < 1) this.idle = window.setTimeout(() => this.sharpen(true), 300);
  }

  protected draw(): void {
    this.renderer.render(this.scene, this.camera);
  }

  dispose(): void {
    clearTimeout(this.idle);
    this.orbit.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private sharpen(on: boolean): void {
    this.isSharp = on;
    this.resize();
  }

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
}
