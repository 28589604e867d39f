/** An opened GLB beside the head: its animation on the page's clock, or a slider per shape. */

import * as THREE from "three";
import type { GLTF } from "three/addons/loaders/GLTFLoader.js";

import { Viewport } from "./viewport";

const FOV_DEGREES = 20;
/** The middle of the gradient behind the embedded head. */
const BACKGROUND = 0x393f47;
/** Uniform vectors of a shader reserved for matrices and lights, not available to shape weights. */
const UNIFORMS_KEPT = 48;
/** Share of the farthest move beyond which a vertex belongs to the face. */
const CLEARLY = 0.08;
/** Position of the camera relative to the face: +x is the character's left, +z the front. */
const VIEWS: Record<string, THREE.Vector3> = {
  face: new THREE.Vector3(0, 0, 1),
  three_quarter: new THREE.Vector3(0.58, 0.05, 0.81),
  side: new THREE.Vector3(1, 0, 0),
  mouth: new THREE.Vector3(0, 0, 1),
};

export class Model extends Viewport {
  /** Seconds of animation; 0 without one. */
  readonly seconds: number;
  readonly shapes: string[];
  private readonly morphing: THREE.Mesh[] = [];
  private readonly mixer: THREE.AnimationMixer;
  private readonly action?: THREE.AnimationAction;
  private readonly frame: THREE.Box3;

  constructor(private readonly gltf: GLTF) {
    super();
    gltf.scene.traverse((node) => {
      if (!(node instanceof THREE.Mesh)) return;
      node.frustumCulled = false;
      if (node.morphTargetInfluences?.length) this.morphing.push(node);
    });
    this.refuseTooMany();
    this.shapes = [...new Set(this.morphing.flatMap((mesh) => Object.keys(mesh.morphTargetDictionary ?? {})))];
    this.scene.add(gltf.scene, ...lights());
    this.scene.background = new THREE.Color(BACKGROUND);
    gltf.scene.updateMatrixWorld(true);
    this.frame = this.movingBox();
    this.mixer = new THREE.AnimationMixer(gltf.scene);
    if (gltf.animations.length) {
      this.action = this.mixer.clipAction(gltf.animations[0]);
      this.action.play();
    }
    this.seconds = gltf.animations[0]?.duration ?? 0;
    this.look("face");
    this.show(0);
  }

  show(seconds: number): void {
    if (this.action) {
      this.action.time = Math.min(Math.max(seconds, 0), this.seconds);
      this.mixer.update(0);
    }
    this.redraw();
  }

  /** Weight of a shape on every mesh that has it. */
  setShape(name: string, weight: number): void {
    for (const { morphTargetDictionary, morphTargetInfluences } of this.morphing) {
      const place = morphTargetDictionary?.[name];
      if (place !== undefined) morphTargetInfluences![place] = weight;
    }
    this.redraw();
  }

  /** Weight of a shape in the file. */
  weight(name: string): number {
    const mesh = this.morphing.find((m) => m.morphTargetDictionary?.[name] !== undefined);
    return mesh?.morphTargetInfluences![mesh.morphTargetDictionary![name]] ?? 0;
  }

  look(view: string): void {
    const { frame } = this;
    const size = frame.getSize(new THREE.Vector3()), target = frame.getCenter(new THREE.Vector3());
    let span = 1.25 * Math.max(size.y, size.x, 1e-6);
    if (view === "mouth") {
      target.y -= 0.22 * size.y;
      span *= 0.45;
    }
    const distance = span / 2 / Math.tan((FOV_DEGREES * Math.PI) / 360) + size.z / 2;
    this.camera.near = distance / 50;
    this.camera.far = distance * 20;
    const direction = VIEWS[view].clone().normalize();
    this.aim(target.clone().addScaledVector(direction, distance), target, FOV_DEGREES);
  }

  /** Vertices of all morphing meshes in the scene's space, as shown. */
  vertices(): Float32Array {
    const point = new THREE.Vector3(), found: number[] = [];
    for (const mesh of this.morphing) {
      for (let k = 0; k < mesh.geometry.attributes.position.count; k++) {
        mesh.getVertexPosition(k, point).applyMatrix4(mesh.matrixWorld);
        found.push(point.x, point.y, point.z);
      }
    }
    return new Float32Array(found);
  }

  dispose(): void {
    this.gltf.scene.traverse((node) => {
      if (node instanceof THREE.Mesh) node.geometry.dispose();
    });
    super.dispose();
  }

  private refuseTooMany(): void {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    const uniforms = gl.getParameter(gl.MAX_VERTEX_UNIFORM_VECTORS) - UNIFORMS_KEPT;
    const most = Math.min(gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS), uniforms);
    const count = Math.max(0, ...this.morphing.map((mesh) => mesh.morphTargetInfluences!.length));
    if (count <= most) return;
    this.dispose();
    throw new Error(`it has ${count} shapes on one mesh; this browser draws at most ${most}`);
  }

  /** Box around the vertices clearly moved by shapes; around all vertices without shapes. */
  private movingBox(): THREE.Box3 {
    const box = new THREE.Box3(), point = new THREE.Vector3();
    const moves = this.morphing.map((mesh) => farthest(mesh.geometry));
    const least = CLEARLY * Math.max(0, ...moves.map((each) => each.reduce((a, b) => Math.max(a, b), 0)));
    this.morphing.forEach((mesh, which) => {
      moves[which].forEach((distance, k) => {
        if (distance > least) box.expandByPoint(mesh.getVertexPosition(k, point).applyMatrix4(mesh.matrixWorld));
      });
    });
    return box.isEmpty() ? box.setFromObject(this.gltf.scene) : box;
  }
}

/** Largest displacement of every vertex over all shapes. */
function farthest(geometry: THREE.BufferGeometry): Float32Array {
  const most = new Float32Array(geometry.attributes.position.count);
  for (const delta of geometry.morphAttributes.position ?? []) {
    for (let k = 0; k < most.length; k++) {
      most[k] = Math.max(most[k], Math.hypot(delta.getX(k), delta.getY(k), delta.getZ(k)));
    }
  }
  return most;
}

function lights(): THREE.Light[] {
  const key = new THREE.DirectionalLight(0xfff4e6, 2.9), rim = new THREE.DirectionalLight(0xb8ccff, 1.2);
  key.position.set(0.62, 0.62, 0.7);
  rim.position.set(-0.85, 0.3, 0.3);
  return [new THREE.HemisphereLight(0xdfe6f2, 0x4a4038, 1.8), key, rim];
}
